"""Estimate the delay of a recording's torque by the robot's dynamics, and decide whether it can be so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from scipy.interpolate import make_interp_spline

from dynident.array_types import FloatArray
from dynident.identification.recording_faults.column_faults import Motion

LATEST, EARLIEST = 0.017, -0.005
"""s between which the delay of a correct log lies: filters of drives delay the torque by up to 14 ms on the open
recordings, and nothing makes it come before its cause (`benchmarks/gross_mistakes.py`)."""

CLEARLY, SURELY = 0.004, 1.5
"""Mean logarithm by which the unexplained share of the torque falls with the delay taken out, and over its standard
error among blocks of time. That a delay cannot be decides more than these do."""

INSIDE = 0.5
"""Share of this that has to fall where the blocks are fitted to, too, with a delay that cannot be either: right motions
that are short, from point to point, gave 0.03 to 0.4; recordings whose torque was made late or early 0.6 and more, and
a delay that differs by up to 9 ms. What comes of it is among the short motions of `benchmarks/gross_mistakes.py`."""

BESIDE_OFFSETS = 0.1
"""Share of this that has to fall beside constant torques as well, which a robot may have. In short right motions of one
that has them it was mostly less than nothing, and at most 0.09; of what can be planted in two recordings of a KR300,
where most of it has a small share, one in twenty gave less. What comes of it is among the short motions of
`benchmarks/gross_mistakes.py`."""

# Delays in s that are tried, closer together near zero; between them a parabola finds the lowest point.
_CANDIDATES = np.array([-0.045, -0.03, -0.02, -0.012, -0.006, 0.0, 0.006, 0.012, 0.02, 0.03, 0.045])
_FEW = 8


class UnexplainedShares(Protocol):
    """Unexplained shares of a torque, as mean logarithms: held out in each block (blocks,), and inside the fit."""

    @property
    def blocks(self) -> FloatArray: ...  # noqa: D102

    @property
    def inside(self) -> float: ...  # noqa: D102


@dataclass(frozen=True)
class Delay:
    """Delay of the torque of a motion.

    Parameters
    ----------
    seconds : float
        The delay in s; below zero where the torque is early.
    is_mistake : bool
        Whether it is a fault of the log, and more than drives delay.
    left_with : float
        Unexplained share of an average joint's torque as it is.
    left_without : float
        The same with the delay taken out.
    """

    seconds: float
    is_mistake: bool
    left_with: float
    left_without: float

    @property
    def is_at_the_end(self) -> bool:
        """Whether it is the largest delay that was tried: the cause then need not be a delay."""
        return abs(self.seconds) >= float(_CANDIDATES.max())


def estimate_delay(
    motion: Motion,
    period: float,
    left_of: Callable[[Motion], UnexplainedShares],
    left_beside: Callable[[Motion], UnexplainedShares],
) -> Delay | None:
    """Find the delay with which the robot explains most; None where the rows are too few.

    Parameters
    ----------
    motion : Motion
        All filtered rows, in their order.
    period : float
        s between rows.
    left_of : function
        Returns the unexplained shares of a motion's torque.
    left_beside : function
        The same beside a constant torque on each joint.

    Returns
    -------
    Delay or None
        The delay, and whether it is a fault; None where the rows are too few.
    """
    if len(motion.q) < _FEW:
        return None
    rows = np.arange(len(motion.q), dtype=np.float64)
    # A delay is no whole number of rows, so the torque is interpolated between them.
    torque = make_interp_spline(rows, motion.tau, k=3)

    def shift_torque(seconds: float) -> Motion:
        return replace(motion, tau=torque(np.clip(rows + seconds / period, 0.0, rows[-1])))

    unexplained = [left_of(shift_torque(float(seconds))) for seconds in _CANDIDATES]
    seconds = _find_lowest(np.array([trial.blocks.mean() for trial in unexplained]))
    inside = np.array([trial.inside for trial in unexplained])
    now, then = unexplained[int(np.flatnonzero(_CANDIDATES == 0.0)[0])], left_of(shift_torque(seconds))
    fall = now.blocks - then.blocks
    # A paired comparison over the same blocks.
    error = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    sure = float(fall.mean()) >= max(CLEARLY, SURELY * error) and now.inside - inside.min() >= INSIDE * fall.mean()
    # Both the held-out estimate and that inside the fit have to be outside of what drives do: in short motions one
    # alone is chance.
    mistaken = sure and not _is_possible_delay(seconds) and not _is_possible_delay(_find_lowest(inside))
    # Tested last, as it needs a second model: made only where all others say yes.
    if mistaken:
        fall_beside_offsets = (left_beside(motion).blocks - left_beside(shift_torque(seconds)).blocks).mean()
        mistaken = fall_beside_offsets >= BESIDE_OFFSETS * fall.mean()
    return Delay(seconds, bool(mistaken), float(np.exp(now.blocks.mean())), float(np.exp(then.blocks.mean())))


def _is_possible_delay(seconds: float) -> bool:
    return EARLIEST <= seconds <= LATEST


def _find_lowest(unexplained: FloatArray) -> float:
    """Return the delay with the smallest unexplained share, by a parabola through the best that was tried."""
    best = int(np.argmin(unexplained))
    if best in (0, len(_CANDIDATES) - 1):
        return float(_CANDIDATES[best])
    x, y = (values[best - 1 : best + 2] for values in (_CANDIDATES, unexplained))
    # A parabola through the best point and its neighbours; it only has a lowest point where it opens upwards.
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-0.5 * b / a, x[0], x[-1])) if a > 0 else float(x[1])
