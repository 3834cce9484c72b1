"""A joint of the virtual robot sticks, holds and breaks away as one of another engine with rigid dry friction does."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import pytest
from engine import FloatArray, usual_drives
from engine.scene import Scene

from dynident.robot import Robot, robot_from_library
from dynident.simulation import Controller, Reference, Sensors, VirtualRobot, spread_over_joints
from dynident.simulation.reference_motion import ReferencePath
from dynident.simulation.virtual_robot import compute_feed_forward_torque, compute_joint_gains

STEP = 0.25e-3
EXACT = Sensors(sampling_rate=1 / STEP, encoder_counts=None, torque_noise=0.0)
SOFT = Controller(bandwidth=6.0)
# The other engine's friction is a very stiff constraint, which gives a little: slower than this (rad/s) it rests.
STILL = 1e-6


@dataclass(frozen=True, eq=False)
class _Followed:
    """q, dq, tau (m, n) of two engines on one motion under one controller; Coulomb friction (n,)."""

    ours: tuple[FloatArray, FloatArray, FloatArray]
    theirs: tuple[FloatArray, FloatArray, FloatArray]
    coulomb: FloatArray


def _from_point_to_point(robot: Robot, moves: int, takes: float, dwell: float) -> Reference:
    """Quintic moves between random points with a rest after each."""
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.8, 0.8, (moves + 1, robot.n))
    points[0, :] = [np.mean(joint.limits.position or (0.0, 0.0)) for joint in robot.joints]
    points[1:] += points[0]
    one = takes + dwell
    t = np.arange(round((moves * one + 0.3) / 1e-3) + 1) * 1e-3
    which = np.minimum((t / one).astype(int), moves - 1)
    s = np.clip((t - which * one) / takes, 0.0, 1.0)[:, None]
    way = points[which + 1] - points[which]
    return Reference(
        t,
        points[which] + way * s**3 * (10 - 15 * s + 6 * s**2),
        way * 30 * s**2 * (1 - s) ** 2 / takes,
        way * 60 * s * (1 - s) * (1 - 2 * s) / takes**2,
    )


def _followed(name: str, takes: float, dwell: float) -> _Followed:
    robot = robot_from_library(name)
    drives = usual_drives(robot)
    friction = (
        *spread_over_joints(robot, "coulomb", "Fc", drives.coulomb),
        *spread_over_joints(robot, "viscous", "Fv", drives.viscous),
        *spread_over_joints(robot, "rotor_inertia", "Ia", drives.rotor),
    )
    reference = _from_point_to_point(robot, 3, takes, dwell)
    virtual = VirtualRobot(robot, friction, controller=SOFT, longest_step=STEP)
    truth = virtual.measure(reference, EXACT).truth

    path = ReferencePath(reference)
    coarse = np.arange(0.0, reference.duration + 2e-3, 1e-3)
    gains = compute_joint_gains(SOFT, virtual.dynamics, path, coarse)
    feed_forward = compute_feed_forward_torque(SOFT, virtual.dynamics, path, coarse)
    t = np.arange(len(truth.q)) * STEP
    wanted, wanted_rate, _ = path.evaluate(t)
    given = np.column_stack([np.interp(t, coarse, feed_forward[:, j]) for j in range(robot.n)])
    limits = np.array([joint.limits.effort or np.inf for joint in robot.joints])
    model, data = Scene.of(robot, drives, STEP).engine()
    data.qpos[:] = wanted[0]
    q, dq, tau = (np.empty_like(truth.q) for _ in range(3))
    for k in range(len(t)):
        torque = given[k] + gains.stiffness * (wanted[k] - data.qpos) + gains.damping * (wanted_rate[k] - data.qvel)
        q[k], dq[k], tau[k] = data.qpos, data.qvel, np.clip(torque, -limits, limits)
        data.ctrl[:] = tau[k]
        mujoco.mj_step(model, data)
    return _Followed((truth.q, truth.dq, truth.tau), (q, dq, tau), drives.coulomb)


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["ur10", "franka_panda"])
@pytest.mark.parametrize(("takes", "dwell"), [(1.0, 0.4), (8.0, 0.4)], ids=["fast", "slow"])
def test_joints_rest_when_and_where_those_of_mujoco_do(name: str, takes: float, dwell: float) -> None:
    found = _followed(name, takes, dwell)
    (q, dq, tau), (their_q, their_dq, their_tau) = found.ours, found.theirs
    assert np.abs(q - their_q).max() < 1e-4
    assert np.all(np.sqrt(np.mean((tau - their_tau) ** 2, axis=0)) < 0.02 * found.coulomb)
    rests, theirs = dq == 0, np.abs(their_dq) < STILL
    assert rests.mean(axis=0).min() > 0.05
    assert np.mean(rests == theirs) > 0.99
