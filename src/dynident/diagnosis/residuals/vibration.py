"""The frequency of a base that shakes: not simply the highest line, since the posture modulates what joints feel."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from dynident.arrays import FloatArray
from dynident.diagnosis.comparing.compare import Comparison
from dynident.effects import Signals
from dynident.expressions import Program

_AROUND, _STEPS_A_WIDTH = 0.3, 4
_MOST_ROWS = 6000


def shaking(
    comparisons: Sequence[Comparison], signals: Signals, reference: FloatArray, lines: Sequence[float]
) -> list[float]:
    """Frequencies (Hz) near spectral lines at which a shaking base explains most of the residual, one a cluster.

    Parameters
    ----------
    reference : (14 n,)
        Parameters that torque is predicted with.
    lines : Hz
        Peaks of the residual's spectrum over time.
    """
    if not lines:
        return []
    columns = [_sensitivities(c, signals, reference) for c in comparisons]
    longest = max(float(c.t[-1] - c.t[0]) for c in comparisons)
    step = 1.0 / (_STEPS_A_WIDTH * longest)
    found: list[float] = []
    for line in lines:
        if any(abs(line - other) <= 2 * _AROUND for other in found):
            continue
        tried = np.arange(max(line - _AROUND, step), line + _AROUND, step)
        gains = [_gain(comparisons, columns, float(value)) for value in tried]
        found.append(float(tried[int(np.argmax(gains))]))
    return found


def _sensitivities(comparison: Comparison, signals: Signals, reference: FloatArray) -> FloatArray:
    """(m, n, 3): torque of every joint for one m/s² of gravity along each axis, over the joint's usual residual."""
    n = signals.robot.n
    torque = ca.horzcat(*(ca.densify(signals.predicted.gravity_torque(axis)) for axis in np.eye(3)))
    program = Program([signals.q, signals.reference], torque)
    every = max(1, len(comparison.t) // _MOST_ROWS)
    values = program(comparison.q[::every], reference).reshape(-1, 3, n).transpose(0, 2, 1)
    return np.asarray(values * _weights(comparison)[:, None])


def _weights(comparison: Comparison) -> FloatArray:
    """(n,): one over every joint's usual residual, zero for one that has none: it stands all the time."""
    rms = comparison.errors.rms
    return np.divide(1.0, rms, out=np.zeros_like(rms), where=rms > 0.0)


def _gain(comparisons: Sequence[Comparison], columns: Sequence[FloatArray], frequency: float) -> float:
    """Squared residual, in units of its own, that a shaking base explains; a phase for every recording."""
    total = 0.0
    for c, sensitivity in zip(comparisons, columns, strict=True):
        every = max(1, len(c.t) // _MOST_ROWS)
        angle = 2 * np.pi * frequency * c.t[::every]
        waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        w = (sensitivity[..., None] * waves[:, None, None, :]).reshape(-1, 6)
        y = (c.told[::every] * _weights(c)).reshape(-1)
        right = w.T @ y
        total += float(right @ np.linalg.lstsq(w.T @ w, right, rcond=1e-9)[0])
    return total
