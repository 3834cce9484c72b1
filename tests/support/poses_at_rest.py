"""Poses at which an arm stands, a row each, as gravity is calibrated from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.oracles import FloatArray, pinocchio_torque

from dynident.robot import Robot


def poses(
    robot: Robot, count: int, seed: int, *, friction: float = 0.0, both_sides: bool = False, offset: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """t (m,) some seconds apart, q and tau (m, n); held by friction of this share of each joint's torque of gravity.

    `both_sides`: every pose has a row for either direction that it was approached from.
    """
    rng = np.random.default_rng(seed)
    low, high = np.array([joint.reach or (-2.5, 2.5) for joint in robot.joints]).T
    q = rng.uniform(np.maximum(low, -2.5), np.minimum(high, 2.5), (count, robot.n))
    side = rng.uniform(-1.0, 1.0, q.shape)
    if both_sides:
        q, side = np.repeat(q, 2, axis=0), np.where(np.arange(2 * count)[:, None] % 2, 1.0, -1.0)
    still = np.zeros_like(q)
    gravity = pinocchio_torque(robot, q, still, still)
    size = np.sqrt((gravity**2).mean(axis=0))
    tau = gravity + friction * size.max() * side + offset + 1e-4 * size.max() * rng.normal(size=q.shape)
    return np.cumsum(rng.uniform(3.0, 8.0, len(q))), q, tau


def write_poses(path: Path, t: FloatArray, q: FloatArray, tau: FloatArray) -> Path:
    joints = range(1, q.shape[1] + 1)
    names = ["t", *(f"q{j}" for j in joints), *(f"tau{j}" for j in joints)]
    np.savetxt(path, np.column_stack([t, q, tau]), delimiter=",", header=",".join(names), comments="", fmt="%.9g")
    return path
