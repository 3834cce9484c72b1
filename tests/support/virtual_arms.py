"""Virtual arms and motions that the tests of this room share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.robot import Robot
from dynident.simulation import Reference, TrueEffect, spread_over_joints

FloatArray = NDArray[np.float64]


def effort(robot: Robot) -> FloatArray:
    return np.array([joint.limits.effort or 50.0 for joint in robot.joints])


def plain_friction(robot: Robot) -> tuple[TrueEffect, ...]:
    """Coulomb 4 %, viscous 3 % of the effort limits, and rotors."""
    return (
        *spread_over_joints(robot, "coulomb", "Fc", 0.04 * effort(robot)),
        *spread_over_joints(robot, "viscous", "Fv", 0.03 * effort(robot)),
        *spread_over_joints(robot, "rotor_inertia", "Ia", 0.003 * effort(robot)),
    )


def fourier(robot: Robot, duration: float, seed: int = 0, rate: float = 500.0, amplitude: float = 0.5) -> Reference:
    """A random Fourier motion about the middle of the ranges, swelling from rest and dying away."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * rate) + 1) / rate
    phases = 2 * np.pi * np.arange(1, 6)[:, None] / 10.0 * t
    q, dq, ddq = (np.zeros((len(t), robot.n)) for _ in range(3))
    rise = min(1.0, duration / 4)
    s = np.clip(np.minimum(t, t[-1] - t) / rise, 0.0, 1.0)
    side = np.where(t < t[-1] / 2, 1.0, -1.0)
    envelope = s**3 * (10 - 15 * s + 6 * s**2)
    d_envelope = side * 30 * s**2 * (1 - s) ** 2 / rise
    dd_envelope = 60 * s * (1 - s) * (1 - 2 * s) / rise**2
    rates = 2 * np.pi * np.arange(1, 6)[:, None] / 10.0
    for j, joint in enumerate(robot.joints):
        low, high = joint.limits.position or (-2.0, 2.0)
        scale = amplitude * min(1.0, (high - low) / 2)
        shifts = rng.uniform(0, 2 * np.pi, (5, 1))
        sizes = rng.uniform(0.3, 1.0, (5, 1)) * scale / 3
        x = (sizes * np.sin(phases + shifts)).sum(axis=0)
        dx = (sizes * rates * np.cos(phases + shifts)).sum(axis=0)
        ddx = -(sizes * rates**2 * np.sin(phases + shifts)).sum(axis=0)
        q[:, j] = (low + high) / 2 + envelope * x
        dq[:, j] = envelope * dx + d_envelope * x
        ddq[:, j] = envelope * ddx + 2 * d_envelope * dx + dd_envelope * x
    return Reference(t, q, dq, ddq)
