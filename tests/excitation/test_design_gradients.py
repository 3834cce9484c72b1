from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from dynident.effects import CATALOGUE, DAHL, STOP, TRAVEL, EffectChoice, MemorySignal
from dynident.effects.hysteresis_states import PathMemory, step_state
from dynident.excitation.criteria.criterion_choice import CRITERIA, CriterionChoice
from dynident.excitation.criteria.design_criterion import build_design_criterion
from dynident.excitation.criteria.optimality_criteria import build_smooth_criterion
from dynident.excitation.design_observation_matrix import ObservationGradient, build_design_model
from dynident.excitation.optimisation.design_problem import DesignProblem, Multipliers
from dynident.motion.collision_free_paths import MoveCost
from dynident.motion.joint_trajectories import FourierFamily
from dynident.motion.limits.bounds import build_bounds
from dynident.robot import robot_from_library, to_pinocchio

MOST = ("rigid_body", "rotor_inertia", "coulomb", "viscous", "offset")
FRICTION = ("coulomb", "viscous", "stribeck", "load_dependent_friction", "base_tilt")


def drawn_states(n: int, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    q, dq, ddq = rng.uniform(-1, 1, (3, count, n)) * np.array([2.0, 2.0, 5.0])[:, None, None]
    return q, dq, ddq


@pytest.mark.parametrize("name", ["franka_panda", "scara", "dual_arm"])
def test_the_torque_that_limits_are_checked_with_is_pinocchios(name):
    robot = robot_from_library(name)
    q, dq, ddq = drawn_states(robot.n, 20)
    model = to_pinocchio(robot)
    data = model.createData()
    expected = np.array([pin.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    ours = build_design_model(robot, [EffectChoice("viscous")]).torque(q, dq, ddq)
    np.testing.assert_allclose(ours, expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("effects", [MOST, FRICTION])
def test_the_fast_observation_matrix_is_that_of_identification_and_predicts_the_torque(panda, effects):
    model = build_design_model(panda, [EffectChoice(name) for name in effects])
    q, dq, ddq = drawn_states(7, 30)
    w = ObservationGradient(model, 30, smooth_sign=1e-9).evaluate(q, dq, ddq)
    b = model.n_parameters
    np.testing.assert_allclose(w[:, :, :b].reshape(-1, b), model.observe(q, dq, ddq), atol=1e-9)
    np.testing.assert_allclose(w @ model.nominal_values, model.torque(q, dq, ddq), atol=1e-4)


@pytest.mark.sweep
@pytest.mark.parametrize("criterion", CRITERIA)
@pytest.mark.parametrize(("name", "effects"), [("scara", MOST), ("ur10", FRICTION)])
def test_the_gradient_over_the_coefficients_agrees_with_finite_differences(name, effects, criterion):
    robot = robot_from_library(name)
    family = FourierFamily(4, 3.0)
    model = build_design_model(robot, [EffectChoice(effect) for effect in effects])
    a_priori = np.geomspace(0.1, 2, model.n_parameters)
    problem = DesignProblem(
        family, model, build_smooth_criterion(CriterionChoice(criterion), a_priori), build_bounds(robot, {})
    )
    rng = np.random.default_rng(2)
    # Beyond the limits, so that all of them act.
    x = rng.standard_normal(family.n_coefficients * robot.n)
    multipliers = Multipliers(rng.uniform(0, 1, (6, problem.n_samples, robot.n)), np.zeros((problem.n_samples, 0)), 3.0)
    at = problem.evaluate(x, multipliers)
    assert (at.excess.max(axis=(1, 2)) > 0).any()
    for _ in range(3):
        direction = rng.standard_normal(x.shape)
        step = 1e-6
        forward, backward = (problem.evaluate(x + s * direction, multipliers).lagrangian for s in (step, -step))
        assert at.gradient @ direction == pytest.approx((forward - backward) / (2 * step), rel=2e-4)


def test_moves_from_and_to_home_cost_the_logarithm_of_the_time_that_they_add(ur10):
    family, bounds = FourierFamily(4, 3.0), build_bounds(ur10, {})
    model = build_design_model(ur10, [EffectChoice(effect) for effect in FRICTION])
    criterion = build_smooth_criterion(CriterionChoice("d_optimal"), np.ones(model.n_parameters))
    moves = MoveCost(family.basis(np.zeros(1))[0, 0], bounds.middle, bounds.velocity, 3.0)
    plain, timed = (DesignProblem(family, model, criterion, bounds, moves=cost) for cost in (None, moves))
    rng = np.random.default_rng(4)
    x = 0.3 * rng.standard_normal(family.n_coefficients * ur10.n)
    without, at = (problem.evaluate(x, problem.create_multipliers(1.0)) for problem in (plain, timed))
    away = np.abs(family.basis(np.zeros(1))[0, 0] @ x.reshape(-1, ur10.n) - bounds.middle) / bounds.velocity
    cost = at.criterion - without.criterion
    assert np.log(1 + 2 * away.max() / 3.0) <= cost <= np.log(1 + 2 * away.sum() / 3.0)
    direction = rng.standard_normal(x.shape)
    forward, backward = (timed.evaluate(x + s * direction, timed.create_multipliers(1.0)) for s in (1e-6, -1e-6))
    assert at.gradient @ direction == pytest.approx((forward.lagrangian - backward.lagrangian) / 2e-6, rel=2e-4)


def test_hysteresis_belongs_to_what_a_motion_can_be_designed_for(panda):
    model = build_design_model(panda, [EffectChoice("viscous"), EffectChoice("presliding", joints=("joint2",))])
    assert model.parameter_names[-2:] == ("Fz2", "cz2")
    assert not model.notes


@pytest.mark.parametrize("criterion", ["condition_number", "a_optimal", "separation"])
def test_the_gradient_goes_through_hysteresis(scara, criterion):
    family = FourierFamily(3, 6.0)
    slip = EffectChoice("presliding", ("elbow",), (("d0", 0.03),))
    model = build_design_model(scara, [EffectChoice("coulomb"), EffectChoice("stribeck", ("elbow",)), slip])
    design_criterion = build_design_criterion(model, CriterionChoice(criterion, effects=(slip,)), {})
    problem = DesignProblem(family, model, design_criterion.smooth_criterion, build_bounds(scara, {}))
    rng = np.random.default_rng(4)
    x = 0.3 * rng.standard_normal(family.n_coefficients * scara.n)
    multipliers = problem.create_multipliers(1.0)
    at = problem.evaluate(x, multipliers)
    for _ in range(3):
        direction = rng.standard_normal(x.shape)
        forward, backward = (problem.evaluate(x + s * direction, multipliers).lagrangian for s in (1e-6, -1e-6))
        assert at.gradient @ direction == pytest.approx((forward - backward) / 2e-6, rel=1e-4)


NOT_IN_THE_MOTION = ("temperature_friction", "warm_up_friction", "payload", "external_contact", "base_vibration")
ABSORBED = ("rigid_body", "rotor_coupling", "encoder_zero_error")


@pytest.mark.sweep
@pytest.mark.parametrize("effect", [name for name in CATALOGUE if name not in (*NOT_IN_THE_MOTION, *ABSORBED)])
def test_every_effect_of_the_motion_can_be_designed_for_with_an_exact_gradient(scara, effect):
    joints = CATALOGUE[effect].applicable(scara)
    last = () if CATALOGUE[effect].scope == "robot" else (scara.joint_names[joints[-1]],)
    choice = EffectChoice(effect, last)
    base = [EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous") if name != effect]
    model = build_design_model(scara, [*base, choice])
    design_criterion = build_design_criterion(model, CriterionChoice("separation", effects=(choice,)), {})
    family = FourierFamily(4, 6.0)
    problem = DesignProblem(family, model, design_criterion.smooth_criterion, build_bounds(scara, {}))
    rng = np.random.default_rng(0)
    x = 0.3 * rng.standard_normal(family.n_coefficients * scara.n)
    multipliers = problem.create_multipliers(1.0)
    direction = rng.standard_normal(x.shape)
    forward, backward = (problem.evaluate(x + s * direction, multipliers) for s in (1e-6, -1e-6))
    # The limits' part is exact as well, and much larger here: without it, the effect's own could hide.
    of_limits = sum(s * (at.lagrangian - at.criterion) for s, at in ((1, forward), (-1, backward))) / 2e-6
    slope = problem.evaluate(x, multipliers).gradient @ direction - of_limits
    assert slope == pytest.approx((forward.criterion - backward.criterion) / 2e-6, rel=1e-3, abs=1e-4)


@pytest.mark.parametrize("effect", NOT_IN_THE_MOTION)
def test_what_is_not_in_the_motion_is_left_out_and_named(scara, effect):
    model = build_design_model(scara, [EffectChoice("viscous"), EffectChoice(effect)])
    assert model.parameter_names == ("Fv1", "Fv2", "Fv3", "Fv4")
    assert "leaves out" in model.notes[0]


def test_states_that_a_path_is_designed_with_are_those_of_a_simulation(scara):
    signals = (MemorySignal(STOP, 0, 0.05), MemorySignal(DAHL, 1, 0.08), MemorySignal(TRAVEL, 2, 0.06))
    t = np.linspace(0, 2 * np.pi, 400, endpoint=False)[:, None]
    q = np.sin(t + np.arange(4)) + 0.3 * np.sin(3 * t)
    states = [0.0, 0.0, 0.0]
    for _ in range(2):
        for k in range(len(q)):
            moved = q[k] - q[k - 1]
            states = [step_state(s, z, moved[s.joint]) for s, z in zip(signals, states, strict=True)]
    np.testing.assert_allclose(PathMemory(signals).compute_states(q, periodic=True)[-1], states, atol=1e-12)
