"""What the recordings would have shown: sizes that are found, and the conclusion that is drawn from them."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, ROBOT, WITH_OFFSET, experiment, nothing, on_joint, recorded
from support.oracles import fourier_motion

from dynident.diagnosis import Diagnosis, DiagnosisChoices, diagnose
from dynident.diagnosis.conclusion import conclude
from dynident.diagnosis.diagnosis_result import DetectionLimit, UnknownPattern
from dynident.effects import get_effect
from dynident.identification import IdentificationChoices, identify
from dynident.presentation.diagnosis_tables import (
    build_conclusion_table,
    build_diagnosis_tables,
    build_limit_table,
    build_limits_by_joint_table,
    format_share,
)
from dynident.reports.figures.diagnosis import draw_detection_limits
from dynident.robot.joint import join_joint_names

HIDDEN = ("joint_spring", "viscous_asymmetric")


@pytest.fixture(scope="module")
def clean() -> Diagnosis:
    run = experiment()
    return diagnose(run.identification, [run.training], DiagnosisChoices((*HIDDEN, "backlash", "coulomb_asymmetric")))


def find_limit(diagnosis: Diagnosis, effect: str, joint: int) -> DetectionLimit:
    return next(item for item in diagnosis.detection_limits if (item.effect, item.joints) == (effect, (NAMES[joint],)))


def test_every_effect_that_was_tried_has_a_limit_on_every_joint_in_the_unit_of_its_parameter(clean):
    for joint in range(ROBOT.n):
        limit = find_limit(clean, "joint_spring", joint)
        assert (limit.parameter, limit.unit) == (f"ks{joint + 1}", "N m/rad")
        usual = get_effect("joint_spring").usual(ROBOT, joint)
        assert usual is not None
        assert limit.usual == pytest.approx(usual.values["ks"])
        assert 0 < limit.half_size <= limit.size
        assert limit.share == pytest.approx(limit.size / limit.usual)


def test_what_the_model_says_itself_shows_in_no_size(clean):
    # The model has an offset, which is the same function.
    assert math.isinf(find_limit(clean, "coulomb_asymmetric", 0).size)


@pytest.mark.parametrize(("factor", "shows"), [(0.3, False), (2.0, True)])
@pytest.mark.parametrize(("effect", "joint"), [("joint_spring", 0), ("viscous_asymmetric", 4)])
def test_twice_the_limit_is_found_and_a_third_of_the_half_limit_is_not(clean, effect, joint, factor, shows):
    limit = find_limit(clean, effect, joint)
    size = factor * (limit.size if shows else limit.half_size)
    laws = {
        "joint_spring": lambda q, v, load: size * (q - 1.0 / 3.0),
        "viscous_asymmetric": lambda q, v, load: size * np.abs(v),
    }
    run = experiment(on_joint(joint, laws[effect]), WITH_OFFSET)
    found = diagnose(run.identification, [run.training], DiagnosisChoices((*HIDDEN, "backlash", "coulomb_asymmetric")))
    named = [(choice.effect, choice.joints) for choice in found.recommended]
    assert named == ([(effect, (NAMES[joint],))] if shows else [])
    if shows:
        # What was found is no longer hidden.
        assert (effect, (NAMES[joint],)) not in {(item.effect, item.joints) for item in found.detection_limits}


def test_a_clean_arm_lacks_nothing_above_the_limits(clean):
    assert clean.verdict == "adequate"
    assert clean.conclusion is not None
    assert clean.conclusion.code == "nothing_above_limits"
    assert clean.conclusion.headline in clean.summary


def test_what_is_too_small_is_told_with_the_size_that_would_have_shown(clean):
    reason = clean.why_not("joint_spring", NAMES[0])
    assert dict(reason.values)["limit"] == find_limit(clean, "joint_spring", 0).size
    assert "These recordings would show it from" in reason.text
    # A limit is that of certain constants.
    shape = find_limit(clean, "backlash", 0).shape
    assert shape
    assert all(f"{name} = {value:.3g}" in clean.why_not("backlash", NAMES[0]).text for name, value in shape)


def test_without_detection_limits_nothing_is_said_of_what_would_have_shown(clean):
    run = experiment()
    quick = diagnose(run.identification, [run.training], DiagnosisChoices(HIDDEN), with_limits=False)
    assert (quick.verdict, quick.recommended, quick.detection_limits) == ("cannot_tell", (), ())
    assert quick.conclusion is not None
    assert (quick.conclusion.code, quick.conclusion.next_action) == ("cannot_tell", None)
    assert "Detection limits were not computed." in quick.summary
    assert clean.conclusion.headline not in quick.summary


def limit_of(effect: str, joint: str, share: float) -> DetectionLimit:
    return DetectionLimit(effect, (joint,), "Fst1", "N m", share, 0.8 * share, 1.0)


SEEN = [limit_of("stribeck", name, 0.2) for name in ("left_knee", "right_knee", "waist")]
BLIND = [limit_of("stribeck", name, 5.0) for name in ("left_knee", "right_knee")] + SEEN[2:]


@pytest.mark.parametrize(
    ("verdict", "limits", "ratios", "code"),
    [
        ("adequate", SEEN, (1.1, 1.1), "nothing_above_limits"),
        ("adequate", SEEN, (math.nan, 1.1), "nothing_above_limits"),
        ("adequate", SEEN, (14.5, 1.1), "cannot_tell"),
        ("adequate", SEEN, (math.nan, 2.5), "cannot_tell"),
        ("adequate", BLIND, (1.1, 1.1), "cannot_tell"),
        ("unexplained", SEEN, (1.1, 1.1), "something_is_missing"),
        ("unexplained", SEEN, (14.5, 1.1), "cannot_tell"),
        ("missing_effect", BLIND, (14.5, 2.5), "something_is_missing"),
    ],
)
def test_the_conclusion_is_threefold_and_names_one_next_thing_to_do(verdict, limits, ratios, code):
    joints = ("left_knee", "right_knee", "waist")
    unknown = (UnknownPattern("waist", "velocity", 0.3),)
    conclusion = conclude(verdict, unknown, limits, ratios, joints, is_given_up=False)
    assert conclusion.code == code
    assert conclusion.next_step.endswith(".")
    actions = {"nothing_above_limits": ["validate"], "cannot_tell": ["record"]}
    assert conclusion.next_action in actions.get(code, ["extend" if verdict == "missing_effect" else "add_own_effect"])
    if code == "cannot_tell":
        assert conclusion.why
    if limits is BLIND and code == "cannot_tell":
        assert "Stribeck friction on left/right_knee" in conclusion.why[-1]


def test_data_that_do_not_determine_the_model_give_the_verdict_that_they_cannot_tell():
    short = recorded(fourier_motion(ROBOT, 4.5, 200.0, 504), on_joint(0, lambda q, v, load: 0.0 * q), 4, "short")
    choices = IdentificationChoices(WITH_OFFSET, preprocessing=BAND)
    found = diagnose(identify(ROBOT, [short], choices=choices), [short], DiagnosisChoices(("stribeck", "joint_spring")))
    assert found.conclusion is not None
    assert (found.verdict, found.conclusion.code, found.recommended) == ("cannot_tell", "cannot_tell", ())
    table = build_conclusion_table(found, ROBOT.joint_names)
    assert table.title == "These data cannot tell whether something is missing."
    assert table.notes[-1] == f"Next: {found.conclusion.next_step}"


def test_many_joints_are_told_in_groups():
    joints = [f"{side}_{name}" for side in ("left", "right") for name in ("hip", "knee", "ankle", "toe")]
    assert join_joint_names(joints, joints) == "all joints"
    assert join_joint_names([j for j in joints if "knee" not in j], joints) == "all but left/right_knee"
    assert join_joint_names(["left_hip", "right_hip", "left_toe"], joints) == "left/right_hip, left_toe"
    assert join_joint_names([], joints) == ""
    assert join_joint_names(joints[:5], joints, 3) == "5 of 8 joints"
    assert join_joint_names(["left_hip", "right_hip", "left_toe"], joints, 2) == "left/right_hip, left_toe"


def test_the_figure_has_all_effects_and_the_table_one_row_an_effect(clean):
    svg = draw_detection_limits(clean.detection_limits, ROBOT)
    assert "Joint spring" in svg
    assert "would have shown at their usual size" in svg
    rows = build_limit_table(clean, ROBOT.joint_names).texts
    assert [row[0] for row in rows] == list(
        dict.fromkeys(get_effect(item.effect).title for item in clean.detection_limits)
    )
    # What shows on no joint, whatever its size, and what shows on one of two.
    limits = [item for item in clean.detection_limits if item.effect == clean.detection_limits[0].effect][:2]
    blind = [replace(item, size=math.inf) for item in limits]
    for own, words in (
        (blind, "no size shows"),
        ([replace(limits[0], size=1.2 * limits[0].usual), blind[1]], "1.2 ×, or no size shows"),
    ):
        table = build_limit_table(replace(clean, detection_limits=tuple(own)), ROBOT.joint_names)
        assert table.texts[0][2] == words
    shares = {0.123: "12\u202f%", 1.0: "1 ×", 3.21: "3.2 ×", 45.6: "46 ×", math.inf: "–"}
    assert {share: format_share(share) for share in shares} == shares


def test_the_tables_say_that_beside_a_baseline_limits_are_of_common_effects(clean):
    note = "With a baseline, only effects that arms often have are listed."
    for diagnosis, is_said in ((clean, False), (replace(clean, changes=()), True)):
        tables = {
            table.name: table for table in build_diagnosis_tables(diagnosis, ROBOT.joint_names, ["N m"] * ROBOT.n)
        }
        each = (tables["limits"], tables["limits_map"], build_limits_by_joint_table(diagnosis))
        assert [note in table.notes for table in each] == [is_said] * 3


def test_known_parameters_are_held_while_effects_are_looked_for() -> None:
    # With the viscous friction free, half of this curve looks like more of it.
    weak = on_joint(0, lambda q, v, load: 0.9 * v * np.abs(v))
    plain, curved = (experiment(hidden, WITH_OFFSET) for hidden in (nothing, weak))
    values = {parameter.name: parameter.value for parameter in plain.identification.parameters}
    known = replace(plain.identification.choices, known={"Fv1": values["Fv1"], "Fc1": values["Fc1"]})
    asked = DiagnosisChoices(("viscous_nonlinear",))
    named = [
        [choice.joints for choice in diagnose(model, [curved.training], asked).recommended]
        for model in (curved.identification, identify(ROBOT, [curved.training], choices=known))
    ]
    assert named == [[], [(NAMES[0],)]]
