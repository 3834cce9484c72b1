"""Findings that are taken back: what is left is more than they explained, or the same kind of function."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, ROBOT, WITH_OFFSET, compared, experiment, motions, on_joint, recorded

from dynident.diagnosis.ambiguities import find_misnamed
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.diagnosis_result import UnknownPattern, Variable
from dynident.diagnosis.search import identifiability_and_invisible_effects
from dynident.diagnosis.search.identifiability_and_invisible_effects import (
    extend_with_findings,
    is_only_helpful_at_first,
)
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import IdentificationChoices, identify
from dynident.identification.identified_models.add_effects import extend_at_once

JOINT = 2


def picked(effect: str, removed: float, joints: tuple[int, ...] = (JOINT,)) -> Finding:
    """A finding on one joint that removed so much squared error of each of `joints`."""
    n, one = ROBOT.n, np.zeros((10, ROBOT.n))
    before = one.copy()
    before[:, list(joints)] = removed / 10
    candidate = Candidate(effect, (NAMES[JOINT],), (), (0,))
    judged = ScoredCandidate(
        candidate, joints, before, one, 0.5, 0.5, 9.0, np.ones(10), 1.0, np.ones(1), 1.0, np.ones(n), np.ones(10)
    )
    return Finding(judged, (), 1e-9)


def taken_back(effect: str, share: float, variable: Variable, *, at: int = JOINT, joints=(JOINT,)) -> bool:
    """Whether a finding is taken back that removed as much as is left in all, of which a share has a pattern."""
    final = compared()
    left = float((final.counted_residual[:, at] ** 2).sum())
    pattern = UnknownPattern(NAMES[at], variable, share)
    finding = picked(effect, left, joints)
    return find_misnamed([finding], [EffectChoice(effect, (NAMES[JOINT],))], [pattern], [final]) == [0]


@pytest.mark.parametrize("variable", ["position", "other_joints"])
def test_a_spring_is_taken_back_where_another_function_of_the_position_is_left(variable):
    assert taken_back("joint_spring", 0.2, variable)
    assert not taken_back("joint_spring", 0.1, variable)


def test_a_spring_is_kept_where_what_is_left_depends_on_something_else():
    assert not taken_back("joint_spring", 0.9, "velocity")


def test_friction_is_taken_back_only_where_it_left_more_than_it_explained():
    assert not taken_back("presliding", 1.0, "acceleration")
    final = compared()
    left = float((final.counted_residual[:, JOINT] ** 2).sum())
    pattern = UnknownPattern(NAMES[JOINT], "acceleration", 0.9)
    small = picked("presliding", 0.5 * left)
    assert find_misnamed([small], [EffectChoice("presliding", (NAMES[JOINT],))], [pattern], [final]) == [0]


def test_a_mass_of_some_runs_is_kept_whatever_all_runs_leave():
    assert not taken_back("payload", 5.0, "position")


def test_a_cable_is_judged_on_both_of_its_joints():
    assert taken_back("cable_force", 0.3, "position", at=JOINT + 1, joints=(JOINT, JOINT + 1))
    assert not taken_back("cable_force", 0.3, "position", at=JOINT + 2, joints=(JOINT, JOINT + 1))


def test_a_group_of_friction_is_not_taken_back_for_one_of_its_joints():
    final = compared()
    finding = picked("presliding", 1e-9)
    group = (NAMES[JOINT], NAMES[JOINT + 1])
    finding = replace(finding, judged=replace(finding.judged, joints=(JOINT, JOINT + 1)))
    pattern = UnknownPattern(NAMES[JOINT], "acceleration", 0.9)
    assert find_misnamed([finding], [EffectChoice("presliding", group)], [pattern], [final]) == []


@pytest.mark.parametrize(
    ("effect", "share", "only_at_first"),
    [("drive_gain_saturation", 2e-3, False), ("drive_gain_saturation", 0.0, True), ("stribeck", 0.0, False)],
)
def test_what_a_predicted_torque_explains_is_kept_where_the_model_identified_with_it_explains_it_too(
    effect: str, share: float, only_at_first: bool
) -> None:
    run = experiment(on_joint(JOINT, lambda q, v, load: share * load * np.abs(load)))
    choice = EffectChoice(effect, (NAMES[JOINT],), (("vs", 0.1), ("delta", 2.0)) if effect == "stribeck" else ())
    grown = extend_at_once(run.identification, [choice], [run.training])
    assert is_only_helpful_at_first(grown, choice) is only_at_first


def test_what_changed_is_not_credited_with_what_the_model_has_on_all_days() -> None:
    saturated = on_joint(JOINT, lambda q, v, load: 2e-3 * load * np.abs(load))
    days = [recorded(motion, saturated, 90 + k, f"day{k}") for k, motion in enumerate(motions(0))]
    known = EffectChoice("drive_gain_saturation", (NAMES[JOINT],))
    model = identify(ROBOT, days, [], IdentificationChoices((*WITH_OFFSET, known), preprocessing=BAND))
    since = replace(known, runs=("day1",))
    grown = extend_at_once(model, [since], days)
    assert is_only_helpful_at_first(grown, since)
    assert not is_only_helpful_at_first(grown, known)


def test_what_helps_no_more_is_found_beside_what_cannot_be_added_and_all_can_be_cancelled(monkeypatch) -> None:
    def extend(model, choices, recordings, progress):
        progress(0.5, "extending")
        if any(choice.effect == "offset" for choice in choices):
            raise DynidentError("its columns are known")
        return object()

    module = identifiability_and_invisible_effects
    monkeypatch.setattr(module, "extend_at_once", extend)
    monkeypatch.setattr(module, "is_only_helpful_at_first", lambda grown, choice: choice.effect == "backlash")
    fractions: list[float] = []

    def note(fraction, message):
        fractions.append(fraction)

    choices = [EffectChoice(name) for name in ("backlash", "offset", "stribeck")]
    grown, gone = extend_with_findings(cast(Any, None), choices, [], note)
    assert {k: reason.code for k, (_, reason) in gone.items()} == {0: "no_help_once_added", 1: "cannot_be_added"}
    assert grown is not None
    # All at once, one by one, then the one that stays.
    np.testing.assert_allclose(fractions, [0.5, 1 / 6, 3 / 6, 5 / 6, 0.5])
