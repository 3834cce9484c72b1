"""What tables and sentences say of the steps of a ladder."""

from __future__ import annotations

import pytest

from dynident.effects import EffectChoice
from dynident.presentation.ladder_tables import (
    Step,
    StepSentence,
    build_ladder_joint_table,
    build_ladder_table,
    build_two_ladders_table,
    describe_last_step,
)
from dynident.presentation.model_tables import ErrorFigures, ErrorKind, build_error_table

JOINTS = ("shoulder", "elbow")
STRIBECK = EffectChoice("stribeck", ("elbow",))


def make_errors(shoulder: float | None, elbow: float | None, total: float | None) -> ErrorFigures:
    return ErrorFigures((shoulder, elbow), (shoulder, elbow), total)


def make_step(
    errors: ErrorFigures, *, added: bool = False, removed: bool = False, confirmed: str = "", size: int | None = 10
) -> Step:
    effects = (STRIBECK,)
    confirming = (confirmed,) if confirmed else ()
    return Step(effects * added, effects * removed, size, errors, errors, errors.relative_total, confirming)


def describe(before: ErrorFigures, **after: object) -> StepSentence:
    last = make_step(**after)  # type: ignore[arg-type]
    return describe_last_step([make_step(before), last], JOINTS)


FIRST = make_errors(0.2, 0.05, 0.16)


@pytest.mark.parametrize(
    ("after", "is_better", "words"),
    [
        ({"errors": make_errors(0.1, 0.05, 0.09), "added": True}, True, "held-out error 16.0\u202f% → 9.00\u202f%"),
        ({"errors": make_errors(0.1, 0.07, 0.09), "added": True}, False, "Worse than before on elbow"),
        ({"errors": make_errors(0.2, 0.05, 0.16), "added": True}, False, "It did not help on data that the fit"),
        ({"errors": FIRST, "added": True, "confirmed": "reversing"}, True, "Held-out data confirm it at reversals."),
        ({"errors": FIRST, "removed": True}, True, "The model does not need it."),
        ({"errors": make_errors(0.2, 0.05, 0.17), "removed": True}, False, "The error is larger without it."),
        ({"errors": make_errors(None, 0.05, 0.05), "added": True}, True, "Added Stribeck friction on elbow"),
    ],
)
def test_the_last_step_is_described(after: dict[str, object], is_better: bool, words: str) -> None:
    sentence = describe(FIRST, **after)
    assert words in sentence.text
    assert sentence.is_better == is_better


def test_the_best_step_is_marked_and_named() -> None:
    steps = [make_step(FIRST), make_step(make_errors(0.1, 0.05, 0.09), added=True), make_step(FIRST, added=True)]
    table = build_ladder_table(steps, JOINTS)
    assert table.marked_rows == (1,)
    assert [row[-1].text for row in table.rows] == ["", "✓ best", "↑ rises"]
    assert table.notes[0].startswith("Model 2 predicts held-out data best; from model 3 on")
    assert [row[1].text for row in table.rows] == ["first model", *["Stribeck friction on elbow"] * 2]
    joints = build_ladder_joint_table(steps, JOINTS)
    assert [row[-1].text for row in joints.rows] == ["1.0 ×", "1.0 ×"]


def test_a_model_is_not_called_best_when_another_predicts_as_well() -> None:
    smaller = make_step(make_errors(0.2, 0.05, 0.1599), added=True)
    table = build_ladder_table([make_step(FIRST), smaller], JOINTS)
    assert [row[-1].text for row in table.rows] == ["✓ preferred", "equal"]
    same = "Models 1 and 2 predict held-out data equally well where joints move; "
    assert table.notes == (f"{same}model 1 is the simplest.",)
    confirmed = make_step(FIRST, added=True, confirmed="reversing")
    assert build_ladder_table([make_step(FIRST), confirmed], JOINTS).notes == (
        f"{same}held-out data confirm what model 2 adds.",
    )


@pytest.mark.parametrize(
    ("totals", "words"),
    [
        ((0.1, 0.2, 0.1001, 0.3), "Models 1 and 3 predict {same}; the held-out error of models 2 and 4 is larger."),
        ((0.1, 0.2, 0.1001, 0.1), "Models 1, 3 and 4 predict {same}; the held-out error of model 2 is larger."),
        ((0.1, 0.1001, 0.2, 0.3), "Models 1 and 2 predict {same}; from model 3 on the held-out error is larger: "),
    ],
)
def test_the_models_whose_error_is_larger_are_named(totals: tuple[float, ...], words: str) -> None:
    table = build_ladder_table([make_step(make_errors(0.1, 0.1, total), added=True) for total in totals], JOINTS)
    same = "held-out data equally well where joints move; model 1 is the simplest"
    assert table.notes[0].startswith(words.format(same=same))
    last = [row[-1].text for row in table.rows]
    assert last.count("↑ rises") + last.count("equal") == 3


@pytest.mark.parametrize(("sizes", "is_said"), [((12, 11, 10), True), ((10, 11, 10), False), ((10, 11, None), False)])
def test_a_model_is_called_the_simplest_by_its_parameters(sizes: tuple[int | None, ...], is_said: bool) -> None:
    steps = [make_step(FIRST, removed=k == 2, size=size) for k, size in enumerate(sizes)]
    table = build_ladder_table(steps, JOINTS)
    assert [row[-1].text for row in table.rows] == ["equal", "equal", "✓ preferred"]
    reason = "; model 3 is the simplest" * is_said
    assert table.notes == (f"Models 1, 2 and 3 predict held-out data equally well where joints move{reason}.",)


def test_two_ladders_of_different_lengths_stand_side_by_side() -> None:
    first, second = make_step(FIRST), make_step(make_errors(0.1, 0.06, 0.09), added=True)
    table = build_two_ladders_table(("a", "b"), ([first, second], [first]), JOINTS)
    assert table.texts[0][5:] == ["0", "0", "0"]
    assert table.texts[1][3:] == ["–"] * 5
    swapped = build_two_ladders_table(("a", "b"), ([second], [first]), JOINTS)
    assert swapped.texts[0][5:] == ["−7.0", "−10", "+1.00"]


def test_errors_say_which_joint_never_moved_and_which_has_no_torque() -> None:
    kind = ErrorKind("fit", make_errors(None, None, None), make_errors(0.1, None, 0.1))
    rows = build_error_table([kind], JOINTS, ("N m", "N m"), (0.1, 0.2)).texts
    assert [row[1] for row in rows] == ["never", "no torque", ""]
    assert [row[3] for row in rows] == ["10.0\u202f%", "–", "10.0\u202f%"]
