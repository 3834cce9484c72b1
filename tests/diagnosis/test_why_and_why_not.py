"""Every candidate of a diagnosis ends with a reason: which rule decided, by which numbers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast, get_args

import numpy as np
import pytest
from support.hidden_effects import CASES, NAMES, WITH_OFFSET, experiment, on_joint
from test_scoring_and_significance import judged

from dynident.diagnosis import Diagnosis, DiagnosisChoices, diagnose
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason, ReasonCode, build_too_small, find_outcome
from dynident.diagnosis.search.acceptance_rules import find_rejection
from dynident.diagnosis.search.identifiability_and_invisible_effects import list_columns_with_findings
from dynident.diagnosis.search.search_state import State
from dynident.effects import EffectChoice, UnknownEffectError
from dynident.errors import DynidentError

DATA = cast(Any, SimpleNamespace(count_rows=lambda columns: np.ones((40, 1))))
STATE = State(DATA, cast(Any, None), (), np.ones(1), 0.1 * np.ones(1))
ROWS = np.ones((40, 1))
GOOD = judged(np.linspace(1.0, 2.0, 40), name="viscous_asymmetric", p=1e-3, t=9.0, before=2.0 * ROWS, after=ROWS)


@pytest.mark.parametrize(
    ("change", "code", "numbers"),
    [
        ({"separability": 0.01}, "not_determined", {"share": 0.01, "least": 0.02}),
        ({"p": 0.04}, "not_significant", {"p": 0.04, "level": 0.01}),
        ({"t": 0.5}, "not_significant", {"t": 0.5}),
        ({"drop": 0.03}, "too_small", {"measure": "squared_error", "share": 0.03, "least": 0.0396}),
        ({"after": 1.99 * ROWS}, "too_small", {"measure": "error", "least": 0.02}),
        ({"separability": 0.025, "t": 3.0}, "not_determined", {"share": 0.025}),
    ],
)
def test_each_rule_returns_its_reason_with_the_numbers_that_decided(change, code, numbers):
    assert find_rejection(STATE, GOOD) is None
    reason = find_rejection(STATE, replace(GOOD, **change))
    assert reason is not None
    assert reason.code == code
    values = dict(reason.values)
    assert {name: values[name] for name in numbers} == pytest.approx(numbers)
    assert reason.text.endswith(".")


def test_a_level_that_the_request_sets_decides():
    weak = replace(GOOD, p=0.04)
    assert find_rejection(replace(STATE, rules=replace(RULES, significance=0.05)), weak) is None


def test_what_removes_less_than_the_sensors_noise_is_too_small_for_it():
    reason = find_rejection(replace(STATE, floor=10.0 * np.ones(1)), GOOD)
    assert reason is not None
    assert dict(reason.values) == pytest.approx({"measure": "noise", "share": 0.01, "least": 0.08})


SAMPLES = {
    "accepted": Reason.build("accepted", 2),
    "equivalent": Reason.build("equivalent", 1, by="Joint spring on elbow"),
    "explained": Reason.build("explained", 1, by="Joint spring on elbow", left=0.12),
    "not_significant": Reason.build("not_significant", p=0.3, level=0.01),
    "too_small": build_too_small("error", 0.013, 0.02),
    "not_determined": Reason.build("not_determined", share=0.001, least=0.02),
    "impossible": Reason.build("impossible", parameter="Fv3", value=-1.2, unit="N m s/rad", violates="below zero"),
    "unstable": Reason.build("unstable", share=0.62, least=0.9),
    "only_at_reversals": Reason.build("only_at_reversals", share=0.001, least=0.02),
    "not_confirmed": Reason.build("not_confirmed", share=0.1, least=0.5),
    "cannot_be_added": Reason.build("cannot_be_added", detail="it is the same as the model."),
    "most_effects": Reason.build("most_effects", most=3.0),
    "not_tried": Reason.build("not_tried", why="the model contains it"),
}


@pytest.mark.parametrize("code", get_args(ReasonCode))
def test_every_code_becomes_a_sentence(code):
    reason = SAMPLES.get(code, Reason.build(code))
    assert reason.text[0].isupper()
    assert reason.text.endswith(".")
    assert 0 < len(reason.brief) < 50


def test_sentences_tell_the_numbers():
    assert SAMPLES["explained"].text == (
        "Explained by step 1 (Joint spring on elbow): after it was added, 12\u202f% of what this effect removes by "
        "itself remains."
    )
    assert "1.3\u202f%" in SAMPLES["too_small"].text
    assert "2\u202f%" in SAMPLES["too_small"].text
    assert "Fv3 would be -1.2 N m s/rad, which is below zero" in SAMPLES["impossible"].text
    assert "62\u202f%" in SAMPLES["unstable"].text


def test_what_was_accepted_answers_before_the_joint_and_the_joint_before_a_group():
    accepted = CandidateOutcome(EffectChoice("stribeck", ("a", "b")), 0.4, Reason.build("accepted", 1))
    single = CandidateOutcome(EffectChoice("stribeck", ("c",)), 0.01, Reason.build("unstable", share=0.5, least=0.9))
    group = CandidateOutcome(EffectChoice("stribeck", ("a", "c")), 0.2, build_too_small("error", 0.0, 0.02))
    outcomes = (group, single, accepted)
    assert find_outcome(outcomes, "stribeck", "a") is accepted
    assert find_outcome(outcomes, "stribeck", "c") is single
    assert find_outcome(outcomes, "stribeck") is accepted
    assert find_outcome(outcomes, "stribeck", "d") is None


@pytest.fixture(scope="module")
def peaked() -> Diagnosis:
    case = CASES["stribeck"]
    run = experiment(case.hidden, case.effects)
    return diagnose(run.identification, [run.training])


def test_a_finding_is_accepted_as_its_step(peaked):
    assert peaked.why_not("stribeck", NAMES[1]) == Reason.build("accepted", 1)
    assert peaked.candidates[0].reason == Reason.build("accepted", 1)


def test_what_resembles_the_finding_is_explained_by_its_step_and_told_beside_it(peaked):
    reason = peaked.why_not("viscous_nonlinear", NAMES[1])
    assert (reason.code, reason.step) == ("explained", 1)
    assert dict(reason.values)["left"] < 0.5
    ranked = next(item for item in peaked.candidates if item.effect == "viscous_nonlinear")
    # By itself it would remove most of the error; the ranking tells what is left beside what ranks above.
    assert ranked.error_drop < 0.1
    assert ranked.reason == reason


def test_drops_of_what_is_no_finding_fall_with_the_rank_and_each_has_its_reason(peaked):
    assert all(item.reason is not None for item in peaked.candidates)
    rejected = [item for item in peaked.candidates if not item.significant]
    assert rejected
    # With everything in the model that there is, nothing large can be left without being named.
    assert max(item.error_drop for item in rejected) < 0.1


def test_every_effect_on_every_joint_has_an_outcome(peaked):
    for joint in NAMES:
        for effect in ("backlash", "joint_spring", "stribeck", "torque_ripple", "temperature_friction", "coulomb"):
            assert isinstance(peaked.why_not(effect, joint), Reason)
    assert "temperature" in peaked.why_not("temperature_friction", NAMES[0]).text
    assert peaked.why_not("coulomb", NAMES[0]) == Reason.build("not_tried", why="the model contains it")
    assert "line" in peaked.why_not("torque_ripple", NAMES[0]).text
    assert peaked.why_not("rigid_body").code == "not_tried"


def test_unknown_effects_and_joints_are_refused(peaked):
    with pytest.raises(UnknownEffectError):
        peaked.why_not("magic", NAMES[0])
    with pytest.raises(DynidentError, match=r"There is no joint 'tail'\. The joints are"):
        peaked.why_not("stribeck", "tail")
    with pytest.raises(DynidentError, match="earlier version"):
        replace(peaked, outcomes=()).why_not("stribeck")


def test_effects_that_were_not_asked_for_and_those_beyond_the_largest_number_are_told_as_such():
    spring, law = CASES["joint_spring"], CASES["viscous_nonlinear"]
    other = on_joint(3, lambda q, v, load: 4.0 * (q - 0.2))

    def both(motion, load):
        return spring.hidden(motion, load) + other(motion, load)

    run = experiment(both, law.effects)
    found = diagnose(run.identification, [run.training], DiagnosisChoices(("joint_spring",), max_effects=1))
    (named,) = found.recommended
    (left,) = {NAMES[0], NAMES[3]} - set(named.joints)
    assert found.why_not("joint_spring", left) == Reason.build("most_effects", most=1.0)
    assert found.why_not("stribeck", NAMES[0]) == Reason.build("not_tried", why="the request does not list it")


def test_the_level_of_the_request_decides():
    # The spring is so weak that its p-value is between the two levels.
    run = experiment(lambda *at: 0.025 * CASES["joint_spring"].hidden(*at), WITH_OFFSET)
    strict, usual = (
        diagnose(run.identification, [run.training], choices).why_not("joint_spring", NAMES[0])
        for choices in (DiagnosisChoices(("joint_spring",), significance=0.001), DiagnosisChoices(("joint_spring",)))
    )
    assert (strict.code, dict(strict.values)["level"]) == ("not_significant", 0.001)
    assert usual.code == "too_small"
    assert "would show it from" in strict.text


def test_a_group_that_is_no_candidate_counts_with_the_columns_of_each_of_its_joints():
    # The search found three joints as a group; one dropped out, so that no candidate has these two.
    def candidate(joints: tuple[str, ...], d0: float, *columns: int) -> Candidate:
        return Candidate("presliding", joints, (("d0", d0),), columns)

    single = [
        candidate((name,), d0, 10 * k + n) for k, name in enumerate("abc", 1) for n, d0 in enumerate((0.001, 0.01))
    ]
    pool = SimpleNamespace(candidates=(*single, candidate(("a", "b", "c"), 0.01, 11, 21, 31)))
    whole = EffectChoice("presliding", ("a", "b", "c"), (("d0", 0.008),))
    assert list_columns_with_findings(pool, (0, 1), [whole]) == (0, 1, 11, 21, 31)
    assert list_columns_with_findings(pool, (0, 1), [replace(whole, joints=("a", "c"))]) == (0, 1, 11, 31)
    assert list_columns_with_findings(pool, (0,), [replace(whole, joints=("b",), shape=(("d0", 0.002),))]) == (0, 20)


def test_patterns_of_many_joints_are_told_by_the_variable():
    from dynident.diagnosis.diagnosis_result import UnknownPattern
    from dynident.diagnosis.diagnosis_summary import group_patterns

    names = [f"{side}_{part}" for part in ("hip", "knee", "ankle", "elbow") for side in ("left", "right")]
    unknown = [UnknownPattern(name, "velocity", 0.1 + 0.01 * k) for k, name in enumerate(names[:-1])]
    unknown.append(UnknownPattern("left_knee", "other_joints", 0.3))
    assert group_patterns(unknown, names) == [
        ("velocity", "all but right_elbow", "10\u202f% to 16\u202f%"),
        ("other joints", "left_knee", "30\u202f%"),
    ]
