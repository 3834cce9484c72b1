"""Decide by its noise whether a torque was computed by a controller or measured."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray

COMPUTED_NOISE, PREDICTABLE_NOISE = 1e-3, 0.03
"""Share of a torque's noise that earlier positions leave unexplained, below which it was computed from them; and share
that the torque's own past has to leave, or it is no noise. Measured torques of the open recordings also hold what the
controller makes of the position's noise, and leave 0.012 and more (`benchmarks/effort_kinds.py`)."""

_ORDER = 3
"""Order of the difference from row to row that removes the motion and leaves the noise."""
_NOISY = 1.5
"""Variance of such a difference over that of the one before: 3.5 of noise alone, 0 of a smooth motion."""
_POSITIONS, _TORQUES = 8, 3
"""Earlier rows that a controller may use: of positions, and of its own output, which it may filter."""
_FEWEST, _MOST = 400, 16_384
"""Rows that are needed, and rows that are used at most, as somebody waits for the answer."""


def is_commanded(q: FloatArray, tau: FloatArray) -> bool | None:
    """Tell whether torques hold no noise but what a controller makes of the noise in the measured positions.

    A measured torque has noise of its own sensor, however well the drive follows the controller.

    Parameters
    ----------
    q, tau : (m, n)
        Consecutive rows, as they were recorded, in any unit.

    Returns
    -------
    bool or None
        The answer of most joints that move. None where they give none: positions or torques are smooth, as if
        filtered or simulated, or there are too few rows.
    """
    if len(q) < _FEWEST:
        return None
    q, tau = q[:_MOST], tau[:_MOST]
    joints = np.flatnonzero((np.ptp(q, axis=0) > 0) & (np.ptp(tau, axis=0) > 0))
    verdicts = [_is_computed(q[:, joint], tau[:, joint]) for joint in joints]
    for answer in (True, False):
        if verdicts and verdicts.count(answer) >= 0.5 * len(verdicts):
            return answer
    return None


def _is_computed(q: FloatArray, tau: FloatArray) -> bool | None:
    """Tell whether one joint's torque was computed from its positions; None where the noise does not tell."""
    if _compute_roughness(q) < _NOISY:
        return None
    before, noise = np.diff(q, n=_ORDER), np.diff(tau, n=_ORDER)
    first = _POSITIONS
    # A controller computes the torque linearly from the last few positions. Regress its noise on theirs.
    positions = [before[first - k : len(before) - k] for k in range(_POSITIONS + 1)]
    torques = [noise[first - k : len(noise) - k] for k in range(1, _TORQUES + 1)]
    target = noise[first:]
    # A torque that its own past predicts is smooth, so there is no noise to decide by.
    if _compute_unexplained(np.column_stack(torques), target) < PREDICTABLE_NOISE:
        return None
    return _compute_unexplained(np.column_stack([*positions, *torques]), target) < COMPUTED_NOISE


def _compute_unexplained(rows: FloatArray, target: FloatArray) -> float:
    """Return the share of the second half's variance that a fit to the first half leaves."""
    half = len(target) // 2
    size = np.sqrt((rows**2).mean(axis=0)) + np.finfo(float).tiny
    solution, *_ = np.linalg.lstsq(rows[:half] / size, target[:half], rcond=1e-12)
    rest = target[half:] - rows[half:] / size @ solution
    return float((rest**2).mean() / max(float((target[half:] ** 2).mean()), np.finfo(float).tiny))


def _compute_roughness(values: FloatArray) -> float:
    size = float(np.diff(values, n=_ORDER).var())
    return float(np.diff(values, n=_ORDER + 1).var()) / size if size > 0 else 0.0
