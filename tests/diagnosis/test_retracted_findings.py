"""Findings that are taken back: what is left is more than they explained, or the same kind of function."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support.hidden_effects import (
    BAND,
    CASES,
    NAMES,
    ROBOT,
    WITH_OFFSET,
    compared,
    experiment,
    motions,
    nothing,
    on_joint,
    recorded,
)

from dynident.diagnosis import diagnose
from dynident.diagnosis.ambiguities import find_misnamed
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.diagnosis_result import UnknownPattern, Variable
from dynident.diagnosis.search import identifiability_and_invisible_effects
from dynident.diagnosis.search.identifiability_and_invisible_effects import (
    can_confirm,
    extend_with_findings,
    is_only_helpful_at_first,
    list_unconfirmed,
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
    def extend(model, choices, recordings, validation, progress):
        progress(0.5, "extending")
        if any(choice.effect == "offset" for choice in choices):
            raise DynidentError("its columns are known")
        return SimpleNamespace(data=SimpleNamespace(held_out=None))

    module = identifiability_and_invisible_effects
    monkeypatch.setattr(module, "extend_at_once", extend)
    monkeypatch.setattr(module, "is_only_helpful_at_first", lambda grown, choice: choice.effect == "backlash")
    fractions: list[float] = []

    def note(fraction, message):
        fractions.append(fraction)

    choices = [EffectChoice(name) for name in ("backlash", "offset", "stribeck")]
    grown, gone = extend_with_findings(cast(Any, None), choices, [], [], note)
    assert {k: reason.code for k, (_, reason) in gone.items()} == {0: "no_help_once_added", 1: "cannot_be_added"}
    assert grown is not None
    # All at once, one by one, then the one that stays.
    np.testing.assert_allclose(fractions, [0.5, 1 / 6, 3 / 6, 5 / 6, 0.5])


@pytest.mark.parametrize("effect", ["joint_spring", "presliding", "torque_ripple"])
def test_only_what_held_out_recordings_have_as_well_is_found(effect: str) -> None:
    case = CASES[effect]
    run = experiment(case.hidden)
    # The same motion of an arm that has not what the recordings of the fit have.
    without = recorded(motions(0)[1], nothing, 7, "validation")
    confirmed, refused = (
        diagnose(run.identification, [run.training], validation=[held_out], candidates=[effect])
        for held_out in (run.validation, without)
    )
    joints = tuple(NAMES[joint] for joint in case.joints)
    assert [(choice.effect, choice.joints) for choice in confirmed.recommended] == [(effect, joints)]
    assert refused.recommended == ()
    reason = refused.why_not(effect, joints[0])
    values = dict(reason.values)
    assert reason.code == "not_confirmed"
    # Where nothing of what is predicted is there, the squared error grows.
    assert values["share"] < 0.0
    assert "their error grows" in reason.text


def test_what_is_there_is_confirmed_beside_what_is_not() -> None:
    case = CASES["stribeck"]
    run = experiment(case.hidden)

    def also(motion, load):
        return case.hidden(motion, load) + on_joint(4, lambda q, v, load: 3.0 * q)(motion, load)

    training = recorded(motions(0)[0], also, 3, "training")
    choices = [
        EffectChoice("stribeck", (NAMES[1],), (("vs", 0.12), ("delta", 2.0))),
        EffectChoice("joint_spring", (NAMES[4],)),
    ]
    plain = identify(ROBOT, [training], [run.validation], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    grown = extend_at_once(plain, choices, [training], [run.validation])
    assert list(list_unconfirmed(grown, choices)) == [1]
    # Nothing is held out: then nothing can refuse it.
    assert list_unconfirmed(extend_at_once(plain, choices, [training]), choices) == {}


def test_held_out_recordings_are_not_asked_what_they_cannot_say() -> None:
    run = experiment()
    warm, loaded = EffectChoice("temperature_friction"), EffectChoice("payload", (NAMES[5],), (), ("training",))
    assert can_confirm([EffectChoice("offset", (NAMES[1],))], [run.validation])
    assert not can_confirm([loaded], [run.validation])
    assert not can_confirm([warm], [run.validation])
    commanded = replace(run.validation, torque_from_commands=True)
    assert not can_confirm([EffectChoice("offset", (NAMES[1],))], [commanded])
