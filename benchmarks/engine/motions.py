"""What the arms are asked to do."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.robot import Robot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """A reference: t (m,), q, dq, ddq (m, n) at the engine's steps."""

    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray


def fourier_motion(
    robot: Robot,
    duration: float,
    seed: int,
    step: float = 0.5e-3,
    harmonics: int = 6,
    period: float = 12.0,
    slope: float = 0.5,
    rise: float = 1.0,
    pace: float = 1.0,
) -> Motion:
    """A Fourier motion of random phases, as large and as fast as the limits let it, swelling from rest in `rise` s.

    The amplitudes of the harmonics fall with the frequency to the power `slope`: the larger, the wider the motion. A
    `pace` below 1 runs it so much more slowly, as an operator's override does.
    """
    rng = np.random.default_rng(seed)
    t: FloatArray = np.arange(round(duration / step) + 1, dtype=np.float64) * step
    rates = 2 * np.pi / period * pace * np.arange(1, harmonics + 1)[:, None]
    swell, dswell, ddswell = _swell(t, rise)
    q, dq, ddq = (np.zeros((len(t), robot.n), dtype=np.float64) for _ in range(3))
    for j, joint in enumerate(robot.joints):
        low, high = joint.limits.position or (-np.pi, np.pi)
        middle, half = (low + high) / 2, min((high - low) / 2, np.pi)
        angle = rates * t + rng.uniform(0, 2 * np.pi, (harmonics, 1))
        size = rng.uniform(0.4, 1.0, (harmonics, 1)) / (rates / pace) ** slope
        x = (size * np.sin(angle)).sum(0)
        dx = (size * rates * np.cos(angle)).sum(0)
        ddx = -(size * rates**2 * np.sin(angle)).sum(0)
        x, dx, ddx = swell * x, swell * dx + dswell * x, swell * ddx + 2 * dswell * dx + ddswell * x
        speed, strength = (pace * limit for limit in (joint.limits.velocity or 2.0, joint.limits.acceleration or 8.0))
        scale = min(0.85 * half / np.abs(x).max(), 0.7 * speed / np.abs(dx).max(), 0.6 * strength / np.abs(ddx).max())
        q[:, j], dq[:, j], ddq[:, j] = middle + scale * x, scale * dx, scale * ddx
    return Motion(t, q, dq, ddq)


def _swell(t: FloatArray, rise: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """A window that rises from 0 to 1 in the first `rise` seconds and falls in the last, with its derivatives, (m,)."""
    left = np.minimum(t, t[-1] - t)
    s = np.clip(left / rise, 0, 1)
    side = np.where(t < t[-1] / 2, 1.0, -1.0) / rise
    return (
        s**3 * (10 - 15 * s + 6 * s**2),
        side * 30 * s**2 * (1 - s) ** 2,
        60 * s * (1 - s) * (1 - 2 * s) / rise**2,
    )
