"""Gears of one arm are not alike: joints of a group with shape constants of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hidden_effects import EFFORT, NAMES, ROBOT, WITH_OFFSET, Hidden, experiment, hysteresis

from dynident.diagnosis import diagnose
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.diagnosis_summary import rank_findings
from dynident.diagnosis.residuals.resolution_at_reversals import Resolution
from dynident.diagnosis.search.finding_refinement import merge_findings_with_close_constants
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import EffectChoice
from dynident.identification import extend
from dynident.identification.shape_search import are_nearly_alike

SHORT, LONG = 0.006, 0.024


def slipping(slips: tuple[float, ...]) -> Hidden:
    """Presliding on every joint, each with a slip distance of its own in rad."""

    def added(motion, load):
        return np.column_stack([0.04 * EFFORT[j] * hysteresis(motion.q[:, j], slip) for j, slip in enumerate(slips)])

    return added


@pytest.mark.slow
def test_gears_that_slip_unlike_far_get_their_own_distances_and_the_prediction_reaches_the_noise():
    slips = (SHORT, SHORT, SHORT, LONG, LONG, LONG)
    run = experiment(slipping(slips), WITH_OFFSET, 3)
    found = diagnose(run.identification, [run.training])
    assert {choice.effect for choice in found.recommended} == {"presliding"}
    told = {joint: choice.shape_values["d0"] for choice in found.recommended for joint in choice.joints}
    assert [told[name] for name in NAMES] == pytest.approx(slips, rel=0.25)
    # The group was found as one; what it explains of a joint is explained by the part that this joint is in.
    explained = [outcome for outcome in found.outcomes if outcome.reason.code == "explained" and outcome.choice.joints]
    assert explained
    for outcome in explained:
        step = outcome.reason.step
        assert step is not None
        assert set(outcome.choice.joints) & set(found.recommended[step - 1].joints), outcome
    grown = extend(run.identification, found.recommended, [run.training], [run.validation])
    true = [presliding(name, slip, 1.0) for name, slip in zip(NAMES, slips, strict=True)]
    best = extend(run.identification, true, [run.training], [run.validation])
    assert grown.held_out_moving.relative_total <= 1.1 * best.held_out_moving.relative_total


@pytest.mark.slow
def test_gears_that_are_alike_are_told_as_one():
    run = experiment(slipping((0.012,) * 6), WITH_OFFSET, 3)
    (choice,) = diagnose(run.identification, [run.training]).recommended
    assert (choice.effect, choice.joints) == ("presliding", NAMES)
    assert choice.shape_values["d0"] == pytest.approx(0.012, rel=0.15)


def power(joint: str, value: float) -> EffectChoice:
    return EffectChoice("viscous_nonlinear", (joint,), (("p", value),))


def presliding(joint: str, slip: float, law: float) -> EffectChoice:
    return EffectChoice("presliding", (joint,), (("d0", slip), ("law", law)))


def test_constants_that_come_out_nearly_the_same_are_the_same():
    assert are_nearly_alike(presliding(NAMES[0], 0.010, 1.0), presliding(NAMES[1], 0.013, 1.0))
    assert not are_nearly_alike(presliding(NAMES[0], 0.010, 1.0), presliding(NAMES[1], 0.020, 1.0))
    assert not are_nearly_alike(presliding(NAMES[0], 0.010, 1.0), presliding(NAMES[1], 0.010, -1.0))


def found_on(choice: EffectChoice) -> Finding:
    """A finding that removes all of the error of its own joints, where each joint has its number as its error."""
    joints = tuple(NAMES.index(name) for name in choice.joints)
    before = np.tile(np.arange(1.0, len(NAMES) + 1.0), (4, 1))
    after = before.copy()
    after[:, joints] = 0.0
    scores = ScoredCandidate(
        Candidate(choice.effect, choice.joints, choice.shape, ()), joints, before, after, 1.0, 9.0,
        (before - after).sum(axis=1), 1.0, np.ones(1), 1.0, before.sum(axis=0), after.sum(axis=1),
    )  # fmt: skip
    return Finding(scores, (), 0.001)


def test_slips_too_short_for_the_data_to_tell_are_one():
    limit = np.full(len(NAMES), 0.001)
    resolved = Resolution(limit, limit, limit, np.ones(len(NAMES)))
    five = replace(presliding(NAMES[0], 0.0012, 1.0), joints=(NAMES[0], *NAMES[2:]))

    def left(slip: float) -> list[EffectChoice]:
        choices = (presliding(NAMES[1], slip, -1.0), five)
        return list(merge_findings_with_close_constants([*map(found_on, choices)], choices, ROBOT, resolved)[1])

    assert left(0.0005) == [replace(five, joints=NAMES)]
    assert left(0.004) == [presliding(NAMES[1], 0.004, -1.0), five]


def test_what_is_merged_is_told_of_the_joints_that_are_left():
    limit = np.full(len(NAMES), 0.001)
    choices = tuple(presliding(NAMES[j], 0.004, 1.0) for j in (5, 1))
    (finding,), (choice,) = merge_findings_with_close_constants(
        [*map(found_on, choices)], choices, ROBOT, Resolution(limit, limit, limit, np.ones(len(NAMES)))
    )
    assert (finding.judged.joints, choice.joints) == ((1, 5), (NAMES[1], NAMES[5]))
    # The one that was found first may drop out: what is told is then what the other explains.
    (ranked,) = rank_findings([finding], [replace(choice, joints=(NAMES[1],))], {})
    assert ranked.joints == (NAMES[1],)
    assert ranked.error_drop == pytest.approx(1.0)


def test_effects_without_constants_or_of_other_runs_stay_apart():
    assert not are_nearly_alike(EffectChoice("offset", NAMES[:1]), EffectChoice("offset", NAMES[1:2]))
    later = EffectChoice("viscous_nonlinear", NAMES[1:2], (("p", 2.0),), ("run 2",))
    assert not are_nearly_alike(power(NAMES[0], 2.0), later)
