"""What a diagnosis proposes to do next: a design that can be run, and what it would tell that the data do not."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest
from support.hidden_effects import BAND, CASES, NAMES, ROBOT, WITH_OFFSET, Experiment, experiment, nothing, recorded
from support.oracles import fourier_motion

from dynident.advice import NextExperiment
from dynident.advice.discriminating_experiments import EXPERIMENTS, Question, choose_experiment
from dynident.advice.next_experiment import next_experiment, restrict_criterion_to_motion
from dynident.diagnosis import Comparison, compare
from dynident.diagnosis.ambiguities import Doubt, list_doubts
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.diagnosis_result import Invisible
from dynident.diagnosis.search.search_state import Finding
from dynident.effects import CATALOGUE, EffectChoice, get_effect
from dynident.excitation import design_experiment
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.identification import IdentificationChoices, identify
from dynident.motion.limits.bounds import build_bounds


def on(joint: int, effect: str, **shape: float) -> EffectChoice:
    return EffectChoice(effect, (NAMES[joint],), tuple(sorted(shape.items())))


PAIRS_TO_DECIDE = {
    "constant_velocity": Doubt(on(0, "stribeck", vs=0.3), (on(0, "viscous_nonlinear", p=2.0),)),
    "reversals": Doubt(on(0, "presliding", d0=0.01), (on(0, "stribeck", vs=0.1),)),
    "slow_sweep": Doubt(
        on(1, "joint_spring"), (on(1, "gravity_compensator", phi=0.1, r=0.25), on(1, "torque_ripple", k=2))
    ),
    "optimized": Doubt(on(2, "load_dependent_friction"), (on(2, "position_dependent_friction", k=1.0),)),
}


@cache
def data() -> tuple[Experiment, tuple[Comparison, ...]]:
    run = experiment(CASES["viscous_nonlinear"].hidden)
    return run, (compare(run.identification, run.training),)


def proposed(*doubts: Doubt) -> NextExperiment | None:
    run, comparisons = data()
    return next_experiment(run.identification, comparisons, doubts)


@cache
def decided(kind: str) -> tuple[NextExperiment | None, float]:
    """What is proposed for a pair, and the processor time in s that this took."""
    data()
    began = time.process_time()
    return proposed(PAIRS_TO_DECIDE[kind]), time.process_time() - began


@pytest.mark.parametrize("kind", PAIRS_TO_DECIDE)
def test_rivals_are_to_be_told_apart_by_a_motion_that_knows_them_better_than_the_data(kind):
    doubt = PAIRS_TO_DECIDE[kind]
    found, _ = decided(kind)
    assert found is not None
    assert found.design.kind == kind
    assert get_effect(doubt.suspect.effect).title in found.reason
    assert get_effect(doubt.rivals[0].effect).title in found.reason
    assert found.present_separation is not None
    assert found.expected_separation is not None
    assert found.expected_separation.parameter == found.present_separation.parameter
    assert found.expected_separation.standard_deviation < 0.8 * found.present_separation.standard_deviation


@pytest.mark.sweep
@pytest.mark.parametrize("kind", PAIRS_TO_DECIDE)
def test_the_promised_deviation_is_that_of_the_design_made_with_the_data_at_hand(kind):
    found, _ = decided(kind)
    assert found is not None
    design = design_experiment(ROBOT, found.design, earlier=[data()[0].training])
    parameter = found.expected_separation.parameter
    made = next(one for one in design.expected if one.name == parameter)
    ratio = made.standard_deviation / found.expected_separation.standard_deviation
    assert 1 / 1.5 < ratio < 1.5
    assert design.criterion_values.criterion < np.inf


def test_a_proposal_does_not_keep_a_diagnosis_waiting():
    # One start of an optimisation, where it is a motion of all joints.
    assert all(decided(kind)[1] < 8.0 for kind in PAIRS_TO_DECIDE)


def test_what_people_have_to_do_is_said_beside_the_design():
    payload, _ = decided("optimized")
    assert payload is not None
    assert any("payload of known mass" in step for step in payload.instructions)
    session = proposed(Doubt(on(2, "temperature_friction"), (on(2, "warm_up_friction", Tw=900.0),)))
    assert session is not None
    assert any("cold" in step for step in session.instructions)
    assert session.expected_separation is None
    design_experiment(ROBOT, session.design)


def test_only_what_most_arms_have_or_somebody_asked_for_is_looked_for_where_it_could_not_be_seen():
    hidden = tuple(
        Invisible(effect, (NAMES[joint],), "too small")
        for effect, joint in (("drive_gain_error", 5), ("joint_spring", 5), ("presliding", 1))
    )

    def suspects(**more) -> list[str]:
        return [doubt.suspect.effect for doubt in list_doubts((), (), hidden, ROBOT, **more)]

    assert suspects() == ["presliding"]
    assert suspects(asked=["joint_spring"]) == ["joint_spring", "presliding"]


def test_an_effect_that_could_not_be_seen_gets_the_motion_that_shows_it():
    """A joint that only ever turns one way round has no reversals in which it would slip first."""
    motion = fourier_motion(ROBOT, 20.0, 200.0, 3, fastest=0.9)
    motion.q[:, 1] = -2.0 + 0.05 * motion.t
    motion.dq[:, 1], motion.ddq[:, 1] = 0.05, 0.0
    run = recorded(motion, nothing, 5, "one way")
    identification = identify(
        ROBOT, [run], [], IdentificationChoices(WITH_OFFSET[:1] + WITH_OFFSET[2:4], preprocessing=BAND)
    )
    doubts = list_doubts((), (), (Invisible("presliding", (NAMES[1],), "too fast"),), ROBOT)
    found = next_experiment(identification, (compare(identification, run),), doubts)
    assert found is not None
    assert found.design.kind == "reversals"
    assert found.design.trajectory.joints == (NAMES[1],)
    assert f"show whether Presliding hysteresis is present on {NAMES[1]}" in found.reason


def test_what_the_data_would_have_shown_is_not_looked_for():
    assert proposed(Doubt(on(1, "stribeck", vs=0.1))) is None


@dataclass(frozen=True)
class Tried:
    """As much of a judged candidate as counts here: where it is, and what it gains in every stretch."""

    candidate: Candidate
    gains: np.ndarray

    @property
    def total_gain(self) -> float:
        return float(self.gains.sum())


def tried(effect: str, gain: float, *joints: int) -> Tried:
    even = np.full(20, gain) + np.linspace(-0.01, 0.01, 20)
    return Tried(Candidate(effect, tuple(NAMES[j] for j in joints), (), (0,)), even)


def picked(effect: str, *joints: int) -> EffectChoice:
    return EffectChoice(effect, tuple(NAMES[j] for j in joints))


def test_a_spring_that_gains_nearly_as_much_as_a_compensator_is_asked_about_before_all_else():
    judged = (tried("gravity_compensator", 0.705, 1), tried("joint_spring", 0.699, 1), tried("stribeck", 0.3, 1))
    chosen = (picked("gravity_compensator", 1), picked("torque_ripple", 3))
    alone = tuple(Finding(item, (), 1e-6) for item in (judged[0], tried("torque_ripple", 0.2, 3)))
    (doubt,) = list_doubts(alone, chosen, (), ROBOT, judged)
    assert doubt == Doubt(chosen[0], (picked("joint_spring", 1),), (chosen[1],))


def test_of_a_group_only_the_joints_with_a_rival_are_in_doubt():
    judged = (
        tried("viscous_nonlinear", 1.0, 0, 5),
        tried("viscous_nonlinear", 0.6, 0),
        tried("stribeck", 0.59, 0),
        tried("stribeck", 0.1, 5),
    )
    group = picked("viscous_nonlinear", 0, 5)
    (doubt,) = list_doubts((Finding(judged[0], (), 1e-6),), (group,), (), ROBOT, judged)
    assert doubt == Doubt(picked("viscous_nonlinear", 0), (picked("stribeck", 0),), (picked("viscous_nonlinear", 5),))


def test_what_includes_the_pick_is_no_rival_and_an_equal_comes_before_what_is_only_near():
    judged = (tried("joint_spring", 0.5, 2), tried("cable_force", 0.52, 2), tried("torque_ripple", 0.49, 2))
    spring = picked("joint_spring", 2)
    (near,) = list_doubts((Finding(judged[0], (judged[1],), 1e-6),), (spring,), (), ROBOT, judged)
    assert near.rivals == (picked("torque_ripple", 2),)
    equal = tried("gravity_compensator", 0.3, 2)
    (doubt,) = list_doubts((Finding(judged[0], (equal,), 1e-6),), (spring,), (), ROBOT, judged)
    assert doubt.rivals == (picked("gravity_compensator", 2),)


def test_nothing_is_proposed_where_nothing_is_open():
    assert proposed() is None


def test_no_motion_is_proposed_for_what_no_motion_can_tell():
    assert proposed(Doubt(on(0, "coulomb_asymmetric"), (on(0, "offset"),))) is None


def test_every_kind_of_experiment_is_named_by_an_effect_and_every_named_one_is_there():
    named = {effect.experiment for effect in CATALOGUE.values()}
    named |= {effect.place_experiment for effect in CATALOGUE.values()}
    named |= {kind for effect in CATALOGUE.values() for kind in effect.told_from}
    assert named == set(EXPERIMENTS)


def test_a_pair_of_effects_is_told_apart_by_one_experiment_that_one_of_the_two_names():
    told = [
        (frozenset((effect.id, other)), kind)
        for effect in CATALOGUE.values()
        for kind, others in effect.told_from.items()
        for other in others
    ]
    pairs = [pair for pair, _ in told]
    assert len(set(pairs)) == len(pairs) > 40
    for pair, kind in told:
        assert len(pair) == 2
        assert pair <= set(CATALOGUE)
        one, other = sorted(pair)
        assert choose_experiment(one, other) is choose_experiment(other, one) is EXPERIMENTS[kind]


def test_what_some_runs_have_is_placed_with_it_left_on():
    left_on = {effect.id for effect in CATALOGUE.values() if effect.place_experiment == "as_it_is"}
    assert left_on == {effect.id for effect in CATALOGUE.values() if effect.in_some_runs}


def test_every_confusion_that_the_catalogue_warns_of_has_an_experiment():
    for effect in CATALOGUE.values():
        for other in effect.confused_with:
            assert choose_experiment(effect.id, other) is not None


@pytest.mark.sweep
@pytest.mark.parametrize("effect", [name for name in CATALOGUE if name not in ("rigid_body", "coulomb", "viscous")])
def test_every_effect_gets_a_design_that_can_be_made(effect):
    possible = CATALOGUE[effect].applicable(ROBOT)
    if effect == "rotor_inertia" or not possible:
        pytest.skip("in the model, or on no joint of this robot")
    grid = CATALOGUE[effect].grid(ROBOT, possible[-1])
    shape = tuple(sorted((name, float(value) or 0.5) for name, value in grid[0].items())) if grid else ()
    joints = () if CATALOGUE[effect].scope == "robot" else (NAMES[possible[-1]],)
    suspect = EffectChoice(effect, joints, shape)
    noise = dict.fromkeys(NAMES, 0.5)
    question = Question(WITH_OFFSET, suspect, None, joints or NAMES, build_bounds(ROBOT, {}), noise, 200.0)
    model = build_design_model(ROBOT, (*WITH_OFFSET, suspect), other_runs=True)
    request = restrict_criterion_to_motion(model, choose_experiment(effect, None).design(question), WITH_OFFSET)
    if request.kind not in ("optimized", "random"):
        assert design_experiment(ROBOT, request).duration < 600
