"""Findings that are taken back: what is left is more than they explained, or the same kind of function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from support.hidden_effects import (
    BAND,
    CASES,
    EFFORT,
    NAMES,
    NOISE,
    ROBOT,
    WITH_OFFSET,
    Hidden,
    compared,
    drives,
    experiment,
    motions,
    nothing,
    on_joint,
    recorded,
)
from support.oracles import FloatArray, Motion, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import DiagnosisChoices, diagnose
from dynident.diagnosis.ambiguities import find_misnamed
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.diagnosis_result import UnknownPattern, Variable
from dynident.diagnosis.disturbances import select_comparable
from dynident.diagnosis.search import identifiability_and_invisible_effects
from dynident.diagnosis.search.identifiability_and_invisible_effects import (
    extend_with_findings,
    is_only_helpful_at_first,
    list_unconfirmed,
)
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import EstimationError
from dynident.identification import IdentificationChoices, identify
from dynident.identification.identified_models.add_effects import extend_at_once
from dynident.progress import ignore_progress

JOINT = 2


def picked(effect: str, removed: float, joints: tuple[int, ...] = (JOINT,)) -> Finding:
    """A finding on one joint that removed so much squared error of each of `joints`."""
    n, one = ROBOT.n, np.zeros((10, ROBOT.n))
    before = one.copy()
    before[:, list(joints)] = removed / 10
    candidate = Candidate(effect, (NAMES[JOINT],), (), (0,))
    judged = ScoredCandidate(
        candidate, joints, before, one, 0.5, 9.0, np.ones(10), 1.0, np.ones(1), 1.0, np.ones(n), np.ones(10)
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
    assert {k: reason.code for k, reason in gone.items()} == {0: "no_help_once_added", 1: "cannot_be_added"}
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
        diagnose(run.identification, [run.training], DiagnosisChoices((effect,)), validation=[held_out])
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
    assert "their squared error grows" in reason.text
    # It has shown, and is not there.
    assert (effect, joints) not in {(item.effect, item.joints) for item in refused.not_visible}


def test_what_is_there_is_confirmed_beside_what_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
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
    solved, solve_with = [], identifiability_and_invisible_effects._solve_with
    monkeypatch.setattr(
        identifiability_and_invisible_effects,
        "_solve_with",
        lambda problem, columns: solved.append(len(columns)) or solve_with(problem, columns),
    )
    assert list(list_unconfirmed(grown, choices)) == [1]
    # The model with all effects is solved once, whichever of them is left out of it.
    assert solved.count(grown.model.n_parameters) == 1
    # Nothing is held out: then nothing can refuse it.
    assert list_unconfirmed(extend_at_once(plain, choices, [training]), choices) == {}


def test_what_the_fit_alone_looks_like_is_refused_by_motion_without_halts() -> None:
    def law(q, v, load):
        curve = 9.0 * np.exp(-((v / 0.12) ** 2)) * np.sign(v)
        # What the model cannot have taken over.
        known = np.stack([np.sign(v), v, np.ones_like(v), q], 1)
        return curve - known @ np.linalg.lstsq(known, curve, rcond=None)[0]

    training = recorded(motions(0)[0], on_joint(1, law), 3, "training")
    without = recorded(motions(0)[1], nothing, 7, "validation")
    choices = [EffectChoice("stribeck", (NAMES[1],), (("vs", 0.12), ("delta", 2.0)))]
    plain = identify(ROBOT, [training], [without], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    assert list(list_unconfirmed(extend_at_once(plain, choices, [training], [without]), choices)) == [0]


SPRING = EffectChoice("joint_spring", (NAMES[0],))
FALSE = EffectChoice("joint_spring", (NAMES[4],))


def springs(motion: Motion, load: FloatArray) -> FloatArray:
    """A spring on each of two joints."""
    return CASES["joint_spring"].hidden(motion, load) + on_joint(4, lambda q, v, load: 6.0 * q)(motion, load)


@pytest.mark.parametrize("estimator", ["irls", "ols"])
def test_every_estimator_is_asked_whether_held_out_recordings_confirm_it(estimator: str) -> None:
    training = recorded(motions(0)[0], springs, 3, "training")
    validation = experiment(CASES["joint_spring"].hidden).validation
    choices = IdentificationChoices(WITH_OFFSET, preprocessing=BAND, estimator=estimator)
    plain = identify(ROBOT, [training], [validation], choices)
    _, dropped = extend_with_findings(plain, [SPRING, FALSE], [training], [validation], ignore_progress)
    assert {k: reason.code for k, reason in dropped.items()} == {1: "not_confirmed"}
    # Where no finding is left, nothing is solved.
    assert list_unconfirmed(cast(Any, SimpleNamespace(data=SimpleNamespace(held_out="rows"))), []) == {}


def test_what_the_description_tells_takes_part_where_some_joints_rest() -> None:
    def rest(motion: Motion) -> Motion:
        q, dq, ddq = (signal.copy() for signal in (motion.q, motion.dq, motion.ddq))
        q[:, :3], dq[:, :3], ddq[:, :3] = q[0, :3], 0.0, 0.0
        return replace(motion, q=q, dq=dq, ddq=ddq)

    hidden = on_joint(4, lambda q, v, load: 6.0 * (q + 0.3))
    training, same = (recorded(rest(motion), hidden, 3 + k, f"run{k}") for k, motion in enumerate(motions(0)))
    other = recorded(rest(motions(0)[1]), nothing, 5, "other")
    moving = (EffectChoice(name, NAMES[3:]) for name in ("rotor_inertia", "coulomb", "viscous", "offset"))
    effects = (EffectChoice("rigid_body"), *moving)
    choices = IdentificationChoices(effects, preprocessing=BAND, prior="description")
    plain = identify(ROBOT, [training], [], choices)
    for held_out, codes in ((same, {}), (other, {0: "not_confirmed"})):
        _, dropped = extend_with_findings(plain, [FALSE], [training], [held_out], ignore_progress)
        assert {k: reason.code for k, reason in dropped.items()} == codes
    saturated = EffectChoice("drive_gain_saturation", (NAMES[4],))
    assert is_only_helpful_at_first(extend_at_once(plain, [FALSE, saturated], [training]), saturated)


def test_what_cannot_be_solved_is_not_tested(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*asked: object) -> None:
        raise EstimationError("no full rank")

    run = experiment(CASES["joint_spring"].hidden)
    without = recorded(motions(0)[1], nothing, 7, "validation")
    grown = extend_at_once(run.identification, [SPRING], [run.training], [without])
    assert list(list_unconfirmed(grown, [SPRING])) == [0]
    monkeypatch.setattr(identifiability_and_invisible_effects, "solve_weighted", refuse)
    assert list_unconfirmed(grown, [SPRING]) == {}


def loaded(mass: float) -> Callable[[Motion, FloatArray], FloatArray]:
    """A spring, and a point mass on the last link, whose torque is that of a heavier body."""

    def hidden(motion: Motion, load: FloatArray) -> FloatArray:
        assert ROBOT.inertias is not None
        inertias = ROBOT.inertias.copy()
        inertias[-1, 9] += mass
        heavier = replace(ROBOT, inertias=inertias)
        more = pinocchio_torque(heavier, motion.q, motion.dq, motion.ddq) - load
        return CASES["joint_spring"].hidden(motion, load) + more

    return hidden


def pushed(motion: Motion, load: FloatArray) -> FloatArray:
    tau = CASES["joint_spring"].hidden(motion, load)
    tau[1000:1400, 0] -= 300.0
    return tau


@pytest.mark.parametrize("hidden", [loaded(8.0), pushed])
def test_what_acts_on_held_out_recordings_alone_refuses_nothing(hidden: Hidden) -> None:
    run = experiment(CASES["joint_spring"].hidden)
    disturbed = recorded(motions(0)[1], hidden, 7, "validation")
    found = diagnose(run.identification, [run.training], DiagnosisChoices(("joint_spring",)), validation=[disturbed])
    assert found.recommended == (SPRING,)
    assert ("s of validation, which is held out, the residual is" in found.summary) == (hidden is pushed)


def test_held_out_recordings_are_asked_where_they_show_what_those_of_the_fit_show() -> None:
    run = experiment()
    grasped = replace(run.validation, payload={"mass": 2.0})
    commanded = replace(run.validation, torque_from_commands=True)
    others = [grasped, replace(run.validation, role="poses"), commanded]
    assert select_comparable(run.identification, [run.training], [*others, run.validation])[0] == (run.validation,)
    assert select_comparable(run.identification, [run.training], others)[0] == ()
    same_load = replace(run.training, payload={"mass": 2.0})
    assert select_comparable(run.identification, [same_load], [grasped, run.validation])[0] == (grasped,)
    warm = EffectChoice("temperature_friction", (NAMES[1],))
    choices = replace(run.identification.choices, effects=(*WITH_OFFSET, warm))
    assert (
        select_comparable(run.identification.with_changes(choices=choices), [run.training], [run.validation])[0] == ()
    )


def test_a_push_is_cut_out_of_held_out_recordings() -> None:
    run = experiment(CASES["joint_spring"].hidden)
    disturbed = recorded(motions(0)[1], pushed, 7, "validation")
    (cut,), (sentence,) = select_comparable(run.identification, [run.training], [disturbed])
    (_, start), (end, _) = cut.windows
    assert 4.5 < start < 5.0 < 7.0 < end < 7.5
    assert "these seconds do not judge what was found" in sentence


@pytest.mark.parametrize("beside", ["runs", "temperature"])
def test_beside_what_held_out_recordings_cannot_say_the_others_are_asked(beside: str) -> None:
    motion = motions(0)[0]
    warmth = np.linspace(0.0, 20.0, len(motion.t))

    def hidden(motion: Motion, load: FloatArray) -> FloatArray:
        if beside == "runs":
            return springs(motion, load)
        slower = on_joint(1, lambda q, v, load: 0.02 * EFFORT[1] * warmth / 20.0 * np.sign(v))
        return springs(motion, load) + slower(motion, load)

    shift = 0.02 * EFFORT * np.eye(ROBOT.n)[1]
    training = [recorded(motion, hidden, 3, "first")]
    validation = experiment(CASES["joint_spring"].hidden).validation
    unasked = EffectChoice("temperature_friction", (NAMES[1],))
    if beside == "runs":
        training.append(
            recorded(fourier_motion(ROBOT, 40.0, 200.0, 300), lambda *at: springs(*at) + shift, 4, "second")
        )
        unasked = EffectChoice("offset", (NAMES[1],), (), ("second",))
    else:
        load = pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq)
        noise = NOISE * np.random.default_rng(3).normal(size=load.shape)
        tau = load + drives(motion) + hidden(motion, load) + noise
        training = [record(ROBOT, motion, tau, "first", temperature=30.0 + np.tile(warmth[:, None], ROBOT.n))]
    plain = identify(ROBOT, training, [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    choices = [unasked, SPRING, FALSE]
    grown, dropped = extend_with_findings(plain, choices, training, [validation], ignore_progress)
    assert {k: reason.code for k, reason in dropped.items()} == {2: "not_confirmed"}
    assert set(grown.choices.effects) >= {unasked, SPRING}
    # They may have what the second run has, but nobody says so.
    alike = recorded(motions(0)[1], lambda *at: springs(*at) + shift, 5, "validation")
    assert extend_with_findings(plain, choices, training, [alike], ignore_progress)[1] == {}
