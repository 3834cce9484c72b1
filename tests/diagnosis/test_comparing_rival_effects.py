"""Names that take much of the same error are weighed with finer constants, and on the rows that both are about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, ROBOT, WITH_OFFSET, nothing, on_joint, recorded
from support.oracles import FloatArray, Motion, fourier_motion, pinocchio_torque

from dynident.diagnosis import diagnose, examine
from dynident.diagnosis.candidates.candidate_pool import build_pool_of_choices
from dynident.diagnosis.changes_between_recordings import identify_on_both
from dynident.diagnosis.search.comparison_of_rivals import name_findings
from dynident.diagnosis.search.finding_refinement import RecordedSource
from dynident.diagnosis.search.next_finding import select_candidate
from dynident.diagnosis.search.search_state import Finding, State, score_family
from dynident.effects import EffectChoice, get_effect
from dynident.identification import IdentificationChoices, identify
from dynident.identification.shape_refinement import list_shape_variables
from dynident.identification.shape_search import list_between
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot import Robot


def _balancer(q, v, load):
    """A spring from a point of the antecedent link to a crank of 0.4, in line at an angle between those of the grid."""
    x = q + 1.57
    length = np.sqrt(1.0 + 0.4**2 + 0.8 * np.cos(x))
    return 60.0 * np.sin(x) * (1.0 - 0.8 / length)


@pytest.mark.sweep
@pytest.mark.parametrize("seed", [3, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2))])
def test_a_balancer_between_two_values_of_the_grid_is_no_cable_and_no_ripple(seed):
    motion = fourier_motion(
        ROBOT, 40.0, 200.0, 100 + seed, base_frequency=0.05, harmonics=4, amplitude=2.8, fastest=1.0
    )
    recording = recorded(motion, on_joint(1, _balancer), seed, "swinging far")
    model = identify(ROBOT, [recording], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = diagnose(model, [recording])
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("gravity_compensator", (NAMES[1],))]
    shape = found.recommended[0].shape_values
    # A crank of so much of the other one's length and one of so many times it are the same spring.
    assert (shape["phi"], min(shape["r"], 1.0 / shape["r"])) == pytest.approx((-1.57, 0.4), rel=0.03)


@pytest.mark.slow
def test_a_balancer_that_two_waves_and_a_third_a_turn_would_say_as_well_is_no_ripple():
    motion = fourier_motion(ROBOT, 24.0, 200.0, 203, base_frequency=0.125, harmonics=3, amplitude=2.2, fastest=2.0)

    def spring(q, v, load):
        length = np.sqrt(1.0 + 0.3**2 + 0.6 * np.cos(q + 0.3))
        return 25.0 * np.sin(q + 0.3) * (1.0 - 0.7 / length)

    recording = recorded(motion, on_joint(1, spring), 3, "three harmonics")
    model = identify(ROBOT, [recording], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    found = diagnose(model, [recording])
    assert [(choice.effect, choice.joints) for choice in found.recommended] == [("gravity_compensator", (NAMES[1],))]


def test_a_wave_that_turns_with_the_joint_closes_after_a_turn():
    (cycles,) = get_effect("torque_ripple").shapes
    assert [cycles.list_allowed_values(k) for k in (2.4, 3.0, 4.9, 5.3)] == [(2.0, 3.0), (3.0,), (4.0, 5.0), (5.3,)]
    slow, fast = (EffectChoice("torque_ripple", (NAMES[1],), (("k", k),)) for k in (3.0, 20.0))
    assert list_between(slow) == [slow]
    assert len(list_between(fast)) == 9
    for k in (5.0, 5.02):
        near = list_between(EffectChoice("torque_ripple", (NAMES[1],), (("k", k),)))
        assert min(choice.shape_values["k"] for choice in near) >= 5.0
    assert [place.choice for place in list_shape_variables([slow, fast])] == [1]
    # Other constants may be below zero, and are searched for all the same.
    spring = EffectChoice("gravity_compensator", (NAMES[1],), (("phi", -0.5), ("r", 0.25)))
    assert len({choice.shape_values["phi"] for choice in list_between(spring)}) == 5


def test_constants_between_those_of_the_grid_are_tried_together_and_stay_what_nature_allows():
    spring = EffectChoice("gravity_compensator", (NAMES[1],), (("phi", 0.0), ("r", 0.25)))
    around = list_between(spring)
    assert around[0] == spring
    assert len(set(around)) == len(around) == 25
    assert min(choice.shape_values["r"] for choice in around) > 0.0
    power = EffectChoice("viscous_nonlinear", (NAMES[0],), (("p", 0.5),))
    assert min(choice.shape_values["p"] for choice in list_between(power)) >= 0.4
    assert list_between(EffectChoice("offset", (NAMES[0],))) == [EffectChoice("offset", (NAMES[0],))]


def heavier_upper_arm(motion: Motion, load: FloatArray) -> FloatArray:
    """A point mass of 1.5 kg on the second link."""
    x, y, z = 0.12, 0.02, 0.03
    inertia = [y * y + z * z, -x * y, -x * z, x * x + z * z, -y * z, x * x + y * y]
    inertias = ROBOT.inertias.copy()
    inertias[1] += 1.5 * np.array([*inertia, x, y, z, 1.0])
    heavy = Robot(ROBOT.name, ROBOT.joints, ROBOT.gravity, ROBOT.drives, ROBOT.description, inertias)
    return pinocchio_torque(heavy, motion.q, motion.dq, motion.ddq) - load


@pytest.mark.slow
def test_a_mass_that_a_spring_would_say_as_well_keeps_its_name_from_day_to_day():
    since = ("friday",)
    mass, spring = (EffectChoice(name, (NAMES[1],), (), since) for name in ("payload", "joint_spring"))
    days = [
        recorded(
            fourier_motion(ROBOT, 20.0, 200.0, seed, base_frequency=0.1, harmonics=5, amplitude=0.8, fastest=1.5),
            heavier,
            seed,
            name,
        )
        for seed, name, heavier in ((300, "monday", nothing), (301, *since, heavier_upper_arm))
    ]
    model = identify(ROBOT, days[:1], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    both, days, _ = identify_on_both(model, days[:1], days[1:])
    pool = replace(build_pool_of_choices(both.model, [mass, spring]), since=since)
    rows = RecordedSource(both.model, RegressorInputs(days, both.preprocessing, both.estimate.next_reference()))
    floor = np.full(6, 0.05)
    state = State(rows.gather_products(pool), pool, tuple(range(pool.n_base)), floor, floor).estimate_noise()
    tried = [pool.find_candidate(choice) for choice in (mass, spring)]
    judged = score_family(state, tried).scored
    choice = select_candidate(state, judged)
    assert choice is not None
    chosen, equal = choice
    (found,) = name_findings(rows, state.add_finding(Finding(chosen, equal, chosen.p))).findings
    assert (found.judged.candidate.choice, [item.candidate.choice for item in found.equal]) == (mass, [spring])


def test_a_balancer_that_a_spring_explains_as_well_is_told_as_either_of_both():
    def spring(q, v, load):
        x = q + 0.2
        return 150.0 * np.sin(x) * (1.0 - 0.8 / np.sqrt(1.25 + np.cos(x)))

    motion = fourier_motion(ROBOT, 24.0, 200.0, 203, base_frequency=0.125, harmonics=3, amplitude=1.0, fastest=2.0)
    recording = recorded(motion, on_joint(1, spring), 3, "a small range")
    model = identify(ROBOT, [recording], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    names = ["gravity_compensator", "joint_spring"]
    found = examine(model, [recording], candidates=names)
    (first, *_), (doubt, *_) = found.diagnosis.candidates, found.doubts
    assert sorted((first.effect, *first.equivalent)) == names
    lacking = found.diagnosis.summary.split(". ")[0].lower()
    assert f" on {NAMES[1]}, or " in lacking
    assert all(part in lacking for part in ("gravity compensating spring", "joint spring"))
    # The next experiment tells them apart.
    assert sorted((doubt.suspect.effect, *(rival.effect for rival in doubt.rivals))) == names
