"""Whether a torque is what a controller computed and not what was measured: told by the noise that is in it."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray

LEFT, LEFT_ALONE = 1e-3, 0.03
"""Share of a torque's noise that positions before it leave where it was computed from them, and that the torque's own
past leaves at least: measured torques of the open recordings, which hold what the controller makes of the position's
noise as well, leave 0.012 and more (`benchmarks/effort_kinds.py`)."""

_ORDER = 3
"""Differences from row to row in which nothing is left of a motion, but noise."""
_NOISY = 1.5
"""Variance of such a difference over that of the one before: 3.5 of noise alone, 0 of a smooth motion."""
_POSITIONS, _TORQUES = 8, 3
"""Rows before that a controller looks at: of positions, and of torques as a filter of its output does."""
_FEWEST, _MOST = 400, 16_384
"""Rows that tell, and that are looked at: somebody waits for it."""


def is_commanded(q: FloatArray, tau: FloatArray) -> bool | None:
    """Whether torques hold no noise but what a controller makes of the measured positions'.

    A measured torque has noise of its own sensor, however well the drive follows the controller.

    Parameters
    ----------
    q, tau : (m, n)
        Consecutive rows, as they were recorded, in any unit.

    Returns
    -------
    What most of the joints that move say; None where they do not: positions or torques are smooth, as if filtered or
    simulated, or there are too few rows.
    """
    if len(q) < _FEWEST:
        return None
    q, tau = q[:_MOST], tau[:_MOST]
    joints = np.flatnonzero((np.ptp(q, axis=0) > 0) & (np.ptp(tau, axis=0) > 0))
    told = [_is_computed(q[:, joint], tau[:, joint]) for joint in joints]
    for answer in (True, False):
        if told and told.count(answer) >= 0.5 * len(told):
            return answer
    return None


def _is_computed(q: FloatArray, tau: FloatArray) -> bool | None:
    if _roughness(q) < _NOISY:
        return None
    before, noise = np.diff(q, n=_ORDER), np.diff(tau, n=_ORDER)
    first = _POSITIONS
    positions = [before[first - k : len(before) - k] for k in range(_POSITIONS + 1)]
    torques = [noise[first - k : len(noise) - k] for k in range(1, _TORQUES + 1)]
    target = noise[first:]
    # What its own past tells of a torque is no noise.
    if _left(np.column_stack(torques), target) < LEFT_ALONE:
        return None
    return _left(np.column_stack([*positions, *torques]), target) < LEFT


def _left(rows: FloatArray, target: FloatArray) -> float:
    """Share of the second half's variance that a fit to the first half leaves."""
    half = len(target) // 2
    size = np.sqrt((rows**2).mean(axis=0)) + np.finfo(float).tiny
    solution, *_ = np.linalg.lstsq(rows[:half] / size, target[:half], rcond=1e-12)
    rest = target[half:] - rows[half:] / size @ solution
    return float((rest**2).mean() / max(float((target[half:] ** 2).mean()), np.finfo(float).tiny))


def _roughness(values: FloatArray) -> float:
    size = float(np.diff(values, n=_ORDER).var())
    return float(np.diff(values, n=_ORDER + 1).var()) / size if size > 0 else 0.0
