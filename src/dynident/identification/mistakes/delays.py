"""By how much the torque of a recording is late, told by the robot's dynamics; and whether that can be so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import make_interp_spline

from dynident.arrays import FloatArray
from dynident.identification.mistakes.swaps import Motion

LATEST, EARLIEST = 0.017, -0.005
"""s between which the torque of a right log is late: filters of drives delay it by up to 14 ms on the open recordings,
and nothing makes it come before its cause (`benchmarks/gross_mistakes.py`)."""

CLEARLY, SURELY = 0.004, 1.5
"""Mean logarithm by which the unexplained share of the torque falls with the delay taken out, and over its standard
error among blocks of time. That a delay cannot be decides more than these do."""

_TRIED = np.array([-0.045, -0.03, -0.02, -0.012, -0.006, 0.0, 0.006, 0.012, 0.02, 0.03, 0.045])
_FEW = 8


@dataclass(frozen=True)
class Delay:
    """Seconds by which the torque is late, whether that is a mistake, and what is left of it with and without."""

    seconds: float
    is_mistake: bool
    left_with: float
    left_without: float


def delay_of(motion: Motion, period: float, blocks_left: Callable[[Motion], FloatArray]) -> Delay | None:
    """Find the delay with which the robot explains most; None where the rows are too few.

    Parameters
    ----------
    motion : all filtered rows, in their order
    period : s between rows
    blocks_left : function
        Gives the mean logarithm of what is left of the torque in each block of time.
    """
    if len(motion.q) < _FEW:
        return None
    rows = np.arange(len(motion.q), dtype=np.float64)
    torque = make_interp_spline(rows, motion.tau, k=3)

    def left(seconds: float) -> FloatArray:
        return blocks_left(replace(motion, tau=torque(np.clip(rows + seconds / period, 0.0, rows[-1]))))

    scores = [left(float(seconds)) for seconds in _TRIED]
    best = int(np.argmin([one.mean() for one in scores]))
    seconds = float(_TRIED[best])
    if 0 < best < len(_TRIED) - 1:
        seconds = _lowest(_TRIED[best - 1 : best + 2], np.array([one.mean() for one in scores[best - 1 : best + 2]]))
    now, then = scores[int(np.flatnonzero(_TRIED == 0.0)[0])], left(seconds)
    fall = now - then
    error = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    sure = float(fall.mean()) >= max(CLEARLY, SURELY * error)
    mistaken = sure and not EARLIEST <= seconds <= LATEST
    return Delay(seconds, bool(mistaken), float(np.exp(now.mean())), float(np.exp(then.mean())))


def _lowest(x: FloatArray, y: FloatArray) -> float:
    """Where a parabola through three points is lowest."""
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-0.5 * b / a, x[0], x[-1])) if a > 0 else float(x[1])
