"""Arms, motions and the rigid-body oracle (Pinocchio) that the tests of several rooms share."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from dynident.recordings import FurtherColumns, Recording, recording_from_arrays
from dynident.robot import Robot, robot_from_library, robot_from_urdf, to_pinocchio

FloatArray = NDArray[np.float64]

# Place in Pinocchio's m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz of XX XY XZ YY YZ ZZ MX MY MZ M.
FROM_PINOCCHIO = [4, 5, 7, 6, 8, 9, 1, 2, 3, 0]
ARMS = ("ur10", "franka_panda", "scara", "dual_arm", "crooked")


def crooked_urdf(n: int = 6, seed: int = 5, sliding: tuple[int, ...] = (2,), parents: tuple[int, ...] = ()) -> str:
    """A URDF whose axes and placements are aligned with nothing, on any tree."""
    rng = np.random.default_rng(seed)
    parents = parents or tuple(range(-1, n - 1))
    parts = ['<robot name="crooked"><link name="base"/>']
    for k in range(n):
        mass = float(rng.uniform(0.5, 4.0))
        a = rng.normal(size=(3, 3))
        inertia = (0.02 * mass * (a @ a.T + 3 * np.eye(3))).tolist()
        centre = rng.uniform(-0.15, 0.15, 3)
        axis = rng.normal(size=3)
        axis /= np.linalg.norm(axis)
        xyz, rpy = rng.uniform(-0.5, 0.5, 3), rng.uniform(-3, 3, 3)
        kind = "prismatic" if k in sliding else "revolute"
        low, high = (-0.5, 0.5) if kind == "prismatic" else (-2.9, 2.9)
        parent = "base" if parents[k] < 0 else f"l{parents[k]}"
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="{_text(centre)}"/><mass value="{mass!r}"/>'
            f'<inertia ixx="{inertia[0][0]!r}" ixy="{inertia[0][1]!r}" ixz="{inertia[0][2]!r}" '
            f'iyy="{inertia[1][1]!r}" iyz="{inertia[1][2]!r}" izz="{inertia[2][2]!r}"/></inertial></link>'
            f'<joint name="j{k}" type="{kind}"><parent link="{parent}"/><child link="l{k}"/>'
            f'<origin xyz="{_text(xyz)}" rpy="{_text(rpy)}"/><axis xyz="{_text(axis)}"/>'
            f'<limit lower="{low}" upper="{high}" velocity="2.5" effort="80"/></joint>'
        )
    return "".join(parts) + "</robot>"


def _text(vector: FloatArray) -> str:
    return " ".join(repr(float(value)) for value in vector)


@cache
def arm(name: str) -> Robot:
    """A well-known arm, or one with crooked axes."""
    return robot_from_urdf("crooked", crooked_urdf()) if name == "crooked" else robot_from_library(name)


@cache
def _pinocchio(robot: Robot):
    model = to_pinocchio(robot)
    return model, model.createData()


def pinocchio_rows(robot: Robot, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """(m, n, 10 n): Pinocchio's joint-torque regressor, columns as in the chapter."""
    model, data = _pinocchio(robot)
    order = (10 * np.arange(robot.n)[:, None] + FROM_PINOCCHIO).reshape(-1)
    rows = [np.array(pin.computeJointTorqueRegressor(model, data, *state)) for state in zip(q, dq, ddq, strict=True)]
    return np.array(rows).reshape(len(q), robot.n, 10 * robot.n)[:, :, order]


def pinocchio_torque(robot: Robot, q: FloatArray, dq: FloatArray, ddq: FloatArray) -> FloatArray:
    """(m, n): the torque of the description's inertias by Pinocchio's recursive Newton-Euler algorithm."""
    model, data = _pinocchio(robot)
    return np.array([pin.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])


@dataclass(frozen=True)
class Motion:
    """t (m,); q, dq, ddq (m, n), exact derivatives of one another."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray


def fourier_motion(
    robot: Robot,
    duration: float,
    rate: float,
    seed: int = 0,
    base_frequency: float = 0.1,
    harmonics: int = 5,
    amplitude: float = 1.2,
    fastest: float = 0.7,
) -> Motion:
    """A random-phase Fourier motion about the middle of the ranges, of at most `fastest` of the velocity limits."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    rates = 2 * np.pi * base_frequency * np.arange(1, harmonics + 1)[:, None]
    q, dq, ddq = (np.zeros((len(t), robot.n)) for _ in range(3))
    for j, joint in enumerate(robot.joints):
        low, high = joint.limits.position or (-2.0, 2.0)
        middle = np.clip(0.5 * (low + high), -1.5, 1.5)
        size = rng.uniform(0.3, 1.0, (harmonics, 1)) / rates**0.5
        angle = rates * t + rng.uniform(0, 2 * np.pi, (harmonics, 1))
        x, dx, ddx = (
            (size * f).sum(axis=0) for f in (np.sin(angle), rates * np.cos(angle), -(rates**2) * np.sin(angle))
        )
        scale = min(0.45 * (high - low), amplitude) / np.abs(x).max()
        limit = joint.limits.velocity or 2.0
        scale = min(scale, fastest * limit / np.abs(dx).max())
        q[:, j], dq[:, j], ddq[:, j] = middle + scale * x, scale * dx, scale * ddx
    return Motion(t, q, dq, ddq)


def record(robot: Robot, motion: Motion, tau: FloatArray, name: str = "run", **more) -> Recording:
    """The motion and torque as a recording of the robot, with what was recorded beside them."""
    beside = FurtherColumns(**{one.name: more.pop(one.name, None) for one in fields(FurtherColumns)})
    columns = {"joint_names": robot.joint_names, "further": beside, "name": name}
    return recording_from_arrays(motion.t, motion.q, tau, **columns, **more)


def random_states(robot: Robot, count: int, seed: int = 0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Three arrays (count, n): q, dq, ddq drawn over everything that an arm does."""
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-np.pi, np.pi, (count, robot.n)),
        rng.uniform(-3, 3, (count, robot.n)),
        rng.uniform(-8, 8, (count, robot.n)),
    )
