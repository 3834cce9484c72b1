from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.effects import EffectChoice
from dynident.excitation.design_observation_matrix import build_design_model
from dynident.motion.jerk_limited_moves import Move, move_within_torque, plan_move
from dynident.motion.joint_trajectories import Rest
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, build_bounds
from dynident.robot import Limits, robot_from_library

BOUNDS = build_bounds(robot_from_library("ur10"), {})


def random_bounds(seed: int) -> Bounds:
    rng = np.random.default_rng(seed)
    n = len(BOUNDS.names)
    velocity, acceleration, jerk = np.exp(
        rng.uniform(np.log([0.05, 0.2, 2])[:, None], np.log([3, 20, 500])[:, None], (3, n))
    )
    return replace(BOUNDS, velocity=velocity, acceleration=acceleration, jerk=jerk)


@given(seed=st.integers(0, 2**32 - 1), rate=st.sampled_from([50.0, 125.0, 1000.0]))
@settings(max_examples=40, deadline=None)
def test_moves_keep_velocity_acceleration_and_jerk_and_go_straight(seed, rate):
    bounds = random_bounds(seed)
    rng = np.random.default_rng(seed + 1)
    start, end = rng.uniform(bounds.position_low, bounds.position_high, (2, 6))
    move = plan_move(start, end, bounds, rate)
    assert isinstance(move, Move)
    assert move.duration * rate == pytest.approx(round(move.duration * rate), abs=1e-6)
    motion = move.evaluate(np.linspace(0, move.duration, 3000))
    for signal, bound in (("dq", bounds.velocity), ("ddq", bounds.acceleration), ("dddq", bounds.jerk)):
        assert (np.abs(getattr(motion, signal)).max(axis=0) <= bound * (1 + 1e-9)).all()
    np.testing.assert_allclose(motion.q[[0, -1]], [start, end], atol=1e-9)
    np.testing.assert_allclose(motion.dq[[0, -1]], 0, atol=1e-9)
    np.testing.assert_allclose(motion.ddq[[0, -1]], 0, atol=1e-6)
    along = (motion.q - start) @ (end - start) / ((end - start) @ (end - start))
    np.testing.assert_allclose(motion.q, start + along[:, None] * (end - start), atol=1e-6)
    assert (np.diff(along) >= -1e-12).all()


def test_the_polynomials_of_a_move_are_derivatives_of_each_other():
    start, end = np.zeros(6), np.array([1.0, -0.5, 2.0, 0.0, 0.1, -1.0])
    move = plan_move(start, end, BOUNDS, 100.0)
    t = np.linspace(0.01, move.duration - 0.01, 500)
    before, at, after = (move.evaluate(t + shift) for shift in (-1e-6, 0.0, 1e-6))
    np.testing.assert_allclose((after.q - before.q) / 2e-6, at.dq, atol=1e-6)
    np.testing.assert_allclose((after.dq - before.dq) / 2e-6, at.ddq, atol=1e-3)


def test_a_move_to_where_the_arm_is_takes_no_time():
    move = plan_move(np.ones(6), np.ones(6), BOUNDS, 100.0)
    assert isinstance(move, Rest)
    assert move.duration == 0.0


def test_a_move_is_slowed_down_until_the_torque_limits_hold(scara):
    model = build_design_model(scara, [EffectChoice("viscous")])
    start, end = np.array([-1.0, -1.0, -0.1, 0.0]), np.array([1.0, 1.0, -0.05, 1.0])
    free = build_bounds(scara, {})
    fast = plan_move(start, end, free, 1000.0).evaluate(np.linspace(0, 0.3, 50))
    needed = np.abs(model.torque(fast.q, fast.dq, fast.ddq)).max(axis=0)
    bounds = build_bounds(scara, {"shoulder": Limits(effort=0.1 * float(needed[0]))})
    move = move_within_torque(start, end, bounds, model, 1000.0)
    motion = move.evaluate(np.linspace(0, move.duration, 5000))
    assert (np.abs(model.torque(motion.q, motion.dq, motion.ddq)) <= bounds.torque * 1.001).all()
    assert move.duration > 2 * plan_move(start, end, free, 1000.0).duration


def test_a_short_move_keeps_the_limit_where_its_design_is_verified(scara):
    model, free = build_design_model(scara, [EffectChoice("viscous")]), build_bounds(scara, {})
    start, end = np.array([-1.0, -1.0, -0.1, 0.0]), np.array([-0.9, -0.9, -0.1, 0.5])

    def find_largest(move, n_samples):
        motion = move.evaluate(np.linspace(0.0, move.duration, n_samples))
        return float(np.abs(model.torque(motion.q, motion.dq, motion.ddq))[:, 3].max())

    move = plan_move(start, end, free, 100.0)
    # Ten times a sampling period, as designs are verified: other times than those of 400 even samples.
    n_verified = int(np.ceil(1000.0 * move.duration)) + 1
    limit = find_largest(move, 400) * (1 + 2e-6)
    assert n_verified < 400
    assert limit < find_largest(move, n_verified)
    slower = move_within_torque(start, end, build_bounds(scara, {"tool_roll": Limits(effort=limit)}), model, 100.0)
    assert find_largest(slower, int(np.ceil(1000.0 * slower.duration)) + 1) <= limit


def test_a_way_on_which_the_arm_cannot_be_held_is_refused_by_the_joint_that_is_too_weak(ur10):
    model = build_design_model(ur10, [EffectChoice("viscous")])
    bounds = build_bounds(ur10, {"shoulder_lift_joint": Limits(effort=30.0)})
    upright = np.array([0, -np.pi / 2, 0, 0, 0, 0])
    with pytest.raises(ImpossibleLimitsError, match=r"'shoulder_lift_joint'.*30"):
        move_within_torque(upright, np.zeros(6), bounds, model, 100.0)
