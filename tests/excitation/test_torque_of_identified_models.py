"""Torque limits of a design by an identified model: friction, rotors, and a margin for what is uncertain."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from support.oracles import FloatArray, Motion, arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.excitation.criteria.criterion_choice import CriterionChoice
from dynident.excitation.criteria.optimality_criteria import build_smooth_criterion
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.excitation.expected_torque import ExpectedTorque, ExpectedTorqueGradient
from dynident.excitation.optimisation.design_problem import DesignProblem
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.identification.identified_models.torque_prediction import predict
from dynident.motion.joint_trajectories import FourierFamily
from dynident.motion.limits.bounds import build_bounds
from dynident.robot import Limits

ROBOT = arm("scara")
COULOMB, VISCOUS, ROTOR = np.array([8.0, 6, 8, 1]), np.array([4.0, 3, 4, 0.5]), np.array([0.5, 0.5, 0.5, 0.02])
LIMITS = {name: Limits(effort=effort) for name, effort in zip(ROBOT.joint_names, (40.0, 30.0, 60.0, 8.0), strict=True)}
SHORT = TrajectoryRequest(duration=4.0, harmonics=3, sampling_rate=100.0)
REQUEST = DesignRequest(trajectory=SHORT, limits=LIMITS, starts=1, random_trajectories=5)
STOP = EffectChoice("presliding", (), (("d0", 0.01), ("law", 1.0)))


def true_torque(motion: Motion) -> FloatArray:
    friction = COULOMB * np.sign(motion.dq) + VISCOUS * motion.dq + ROTOR * motion.ddq
    return pinocchio_torque(ROBOT, motion.q, motion.dq, motion.ddq) + friction


@cache
def model_of(*effects: EffectChoice) -> Identification:
    motion = fourier_motion(ROBOT, 15.0, 200.0, 1)
    tau = true_torque(motion) + np.random.default_rng(1).normal(0.0, 0.3, motion.q.shape)
    choices = IdentificationChoices(effects) if effects else IdentificationChoices()
    return identify(ROBOT, [record(ROBOT, motion, tau)], [], choices)


def test_the_expected_torque_is_the_outer_end_of_the_interval_of_a_prediction():
    motion, estimate = fourier_motion(ROBOT, 5.0, 100.0, 3), model_of().estimate
    predicted = predict(estimate, motion.q, motion.dq, motion.ddq)
    outer = predicted.torque + np.sign(predicted.torque) * predicted.half_width
    found = ExpectedTorque(ROBOT, estimate).torque(motion.q, motion.dq, motion.ddq)
    np.testing.assert_allclose(found, outer, rtol=1e-6, atol=1e-6 * np.abs(outer).max())
    assert (np.abs(found) > np.abs(predicted.torque)).all()


def test_hysteresis_counts_as_in_steady_motion_where_it_is_largest():
    motion = fourier_motion(ROBOT, 5.0, 100.0, 3)
    effects = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
    plain, remembering = model_of(*effects), model_of(*effects, STOP)
    assert remembering.model.observation.memory
    found, expected = (
        ExpectedTorque(ROBOT, one.estimate).torque(motion.q, motion.dq, motion.ddq) for one in (remembering, plain)
    )
    # Coulomb friction is split between two columns, which come to the same where a joint slides.
    assert np.abs(found - expected).max() < 0.1 * np.abs(expected).max()


def test_a_model_of_friction_alone_is_completed_by_the_links_of_the_description():
    motion = fourier_motion(ROBOT, 5.0, 100.0, 3)
    friction = record(ROBOT, motion, COULOMB * np.sign(motion.dq) + VISCOUS * motion.dq)
    choices = IdentificationChoices((EffectChoice("coulomb"), EffectChoice("viscous")))
    expected = ExpectedTorque(ROBOT, identify(ROBOT, [friction], [], choices).estimate)
    assert "with the links of the robot's description" in expected.note
    found = expected.torque(motion.q, motion.dq, motion.ddq)
    true = true_torque(motion) - ROTOR * motion.ddq
    sliding = np.abs(motion.dq) > 0.05
    assert np.abs(found - true)[sliding].max() < 0.05 * np.abs(true).max()
    bare = replace(ROBOT, inertias=None)
    assert ExpectedTorque(bare, identify(bare, [friction], [], choices).estimate).complete_note is None


def test_the_gradient_of_the_expected_torque_agrees_with_finite_differences():
    gradient = ExpectedTorqueGradient(ExpectedTorque(ROBOT, model_of().estimate), 0.05)
    rng = np.random.default_rng(0)
    state, seeds = rng.uniform(-1, 1, (3, 40, ROBOT.n)), rng.normal(size=(40, ROBOT.n))
    gradient.evaluate(*state)
    swept = np.array(gradient.pull_back(seeds))
    for part in range(3):
        for joint in range(ROBOT.n):
            step = np.zeros_like(state)
            step[part, :, joint] = 1e-6
            ahead, behind = gradient.evaluate(*(state + step)), gradient.evaluate(*(state - step))
            slope = ((ahead - behind) / 2e-6 * seeds).sum(axis=1)
            np.testing.assert_allclose(swept[part, :, joint], slope, atol=1e-5 * np.abs(swept).max())


def test_the_gradient_of_a_design_whose_torque_is_that_of_a_model_agrees_with_finite_differences():
    expected = ExpectedTorque(ROBOT, model_of().estimate)
    model = build_design_model(ROBOT, REQUEST.effects_or_default, expected=expected)
    family, criterion = FourierFamily(3, 3.0), CriterionChoice()
    problem = DesignProblem(
        family,
        model,
        build_smooth_criterion(criterion, np.ones(model.n_parameters)),
        build_bounds(ROBOT, LIMITS, torque_note=expected.note),
    )
    x = 0.5 * np.random.default_rng(2).normal(size=family.n_coefficients * ROBOT.n)
    multipliers = problem.create_multipliers(10.0)
    found = problem.evaluate(x, multipliers)
    assert found.excess[4].max() > 0
    way = np.random.default_rng(3).normal(size=len(x))
    ahead, behind = (problem.evaluate(x + step * way, multipliers).lagrangian for step in (1e-6, -1e-6))
    assert found.gradient @ way == pytest.approx((ahead - behind) / 2e-6, rel=1e-4)


@pytest.mark.parametrize("family", ["fourier", "point_to_point"])
def test_a_design_keeps_the_torque_limits_of_the_real_arm_once_its_model_is_known(family: str):
    request = replace(REQUEST, trajectory=replace(SHORT, family=family, points=6))
    torques = {}
    for known in (False, True):
        design = design_experiment(ROBOT, request, identified=model_of().estimate if known else None)
        motion = Motion(design.t, design.q, design.dq, design.ddq)
        torques[known] = (np.abs(true_torque(motion)).max(axis=0), design)
    limits = np.array([LIMITS[name].effort for name in ROBOT.joint_names])
    assert (torques[False][0] > limits).any()
    assert (torques[True][0] <= limits).all()
    assert any("without rotor inertia and friction" in note for note in torques[False][1].notes)
    assert any("by the identified model, at the outer end" in note for note in torques[True][1].notes)
    assert not any("Leave room" in note for note in torques[True][1].notes)


def test_friction_above_a_limit_makes_every_motion_impossible_and_says_so():
    weak = {**LIMITS, "tool_roll": Limits(effort=0.9)}
    with pytest.raises(DynidentError, match="torque limits allow no motion"):
        design_experiment(ROBOT, replace(REQUEST, limits=weak), identified=model_of().estimate)


def test_torque_of_a_robot_without_inertias_is_checked_by_its_model():
    bare = replace(ROBOT, inertias=None)
    assert not any(m.limit == "torque" for m in design_experiment(bare, REQUEST).margins)
    design = design_experiment(bare, REQUEST, identified=model_of().estimate)
    assert {m.joint for m in design.margins if m.limit == "torque"} == set(ROBOT.joint_names)
    assert np.abs(true_torque(Motion(design.t, design.q, design.dq, design.ddq))).max(axis=0)[0] <= 40.0


def test_a_model_of_another_robot_is_refused():
    with pytest.raises(DynidentError, match="the model is of a robot with the joints"):
        ExpectedTorque(arm("ur10"), model_of().estimate)
