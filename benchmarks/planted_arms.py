"""Arms whose recordings mistakes are planted in: rigid ones, elastic ones, and motions that excite little.

The link side moves along a Fourier motion. An elastic joint's motor is ahead of its link by the torque over the
stiffness, and the link rattles at a few Hz, which no rigid model explains. The torque is Pinocchio's, with the inertia
of the rotor, Coulomb and viscous friction, and noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from common import FloatArray

from dynident.robot import Robot, robot_from_library, robot_from_urdf
from dynident.robot.pinocchio_conversion import compute_described_torque

Kind = Literal["rigid", "elastic", "poor"]
KINDS: tuple[Kind, ...] = ("rigid", "elastic", "poor")
ARMS = ("ur10", "franka_panda", "ur5", "pendulum")
RATE = 200.0
Columns = dict[str, FloatArray]


def drawn_arms(rng: np.random.Generator, cases: int) -> Iterator[tuple[str, Robot, Columns]]:
    """Recordings of drawn arms as columns of a file in SI units, with a name each; kinds take turns."""
    for case in range(cases):
        kind, name = KINDS[case % len(KINDS)], ARMS[int(rng.integers(len(ARMS)))]
        robot = pendulum(rng) if name == "pendulum" else robot_from_library(name)
        yield f"{kind} {name} {case}", robot, recorded_columns(robot, kind, rng)


def pendulum(rng: np.random.Generator) -> Robot:
    """Two joints that turn about parallel level axes."""
    lengths, masses = rng.uniform(0.2, 0.4, 2), rng.uniform(0.4, 1.0, 2)
    parts = ['<robot name="pendulum"><link name="base"/>']
    for k, (length, mass) in enumerate(zip(lengths, masses, strict=True)):
        inertia = mass * length**2 / 12.0
        height = -lengths[0] if k else 0.0
        parts.append(
            f'<link name="link{k + 1}"><inertial><origin xyz="0 0 {-0.5 * length}"/><mass value="{mass}"/>'
            f'<inertia ixx="{inertia}" ixy="0" ixz="0" iyy="{inertia}" iyz="0" izz="{0.1 * inertia}"/></inertial>'
            "</link>"
            f'<joint name="joint{k + 1}" type="revolute"><parent link="{"link1" if k else "base"}"/>'
            f'<child link="link{k + 1}"/><origin xyz="0 0 {height}"/><axis xyz="0 1 0"/>'
            '<limit lower="-6.3" upper="6.3" velocity="20" effort="8"/></joint>'
        )
    return robot_from_urdf("pendulum", "".join(parts) + "</robot>")


def recorded_columns(robot: Robot, kind: Kind, rng: np.random.Generator) -> Columns:
    """The columns t, q1, … and tau1, … of a recording."""
    poor = kind == "poor"
    t = np.arange(round((8.0 if poor else 20.0) * RATE)) / RATE
    q, dq, ddq = _fourier(robot, t, 0.3 if poor else 1.2, rng)
    if kind == "elastic":
        rattle = 2.0 * np.pi * rng.uniform(5.0, 9.0)
        # As much acceleration as the motion itself has: what the positions say of it, a rigid model cannot use.
        size = rng.uniform(0.5, 1.2) * ddq.std(axis=0) / rattle**2
        angle = rattle * t[:, None] + rng.uniform(0, 2 * np.pi, robot.n)
        q, dq, ddq = (
            q + size * np.sin(angle),
            dq + size * rattle * np.cos(angle),
            ddq - size * rattle**2 * np.sin(angle),
        )
    torque = compute_described_torque(robot, q, dq, ddq)
    peak = np.maximum(np.abs(torque).max(axis=0), 0.05 * np.abs(torque).max())
    if kind == "elastic":
        # The motor stands up to 0.05 rad ahead of its link.
        ahead = torque / peak * rng.uniform(0.02, 0.05, robot.n)
        q = q + ahead
        dq, ddq = (np.gradient(signal, 1.0 / RATE, axis=0) for signal in (q, np.gradient(q, 1.0 / RATE, axis=0)))
    rotor = rng.uniform(0.02, 0.1, robot.n) * peak / np.maximum(ddq.std(axis=0), 1e-9)
    speed = dq / np.maximum(np.abs(dq).max(axis=0), 1e-9)
    dry, viscous = (peak * rng.uniform(0.05, 0.12, robot.n) for _ in range(2))
    torque = torque + rotor * ddq + dry * np.sign(dq) + viscous * speed
    torque = torque + rng.uniform(0.005, 0.04 if poor else 0.02) * peak * rng.normal(size=torque.shape)
    q = q + 2e-5 * rng.normal(size=q.shape)
    named = {f"{kind}{k + 1}": values[:, k] for kind, values in (("q", q), ("tau", torque)) for k in range(robot.n)}
    return {"t": t} | named


def _fourier(
    robot: Robot, t: FloatArray, amplitude: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, FloatArray]:
    rates = 2.0 * np.pi * rng.uniform(0.1, 0.2) * np.arange(1, 6)
    q, dq, ddq = (np.zeros((len(t), robot.n)) for _ in range(3))
    for j, joint in enumerate(robot.joints):
        low, high = joint.limits.position or (-2.0, 2.0)
        angle = rates * t[:, None] + rng.uniform(0, 2 * np.pi, 5)
        size = rng.uniform(0.3, 1.0, 5) / np.sqrt(rates)
        parts = np.sin(angle) @ size, np.cos(angle) @ (size * rates), -np.sin(angle) @ (size * rates**2)
        scale = min(amplitude, 0.45 * (high - low)) / np.abs(parts[0]).max()
        q[:, j], dq[:, j], ddq[:, j] = (scale * part for part in parts)
        q[:, j] += np.clip(0.5 * (low + high), -1.5, 1.5)
    return q, dq, ddq
