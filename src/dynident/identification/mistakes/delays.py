"""By how much the torque of a recording is late, told by the robot's dynamics; and whether that can be so."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

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

INSIDE = 0.5
"""Share of this that has to fall where the blocks are fitted to, too, with a delay that cannot be either: right motions
that are short, from point to point, gave 0.03 to 0.4; recordings whose torque was made late or early 0.6 and more, and
a delay that differs by up to 9 ms. What comes of it is among the short motions of `benchmarks/gross_mistakes.py`."""

BESIDE_OFFSETS = 0.1
"""Share of this that has to fall beside constant torques as well, which a robot may have. In short right motions of one
that has them it was mostly less than nothing, and at most 0.09; of what can be planted in two recordings of a KR300,
where most of it has a small share, one in twenty gave less. What comes of it is among the short motions of
`benchmarks/gross_mistakes.py`."""

_TRIED = np.array([-0.045, -0.03, -0.02, -0.012, -0.006, 0.0, 0.006, 0.012, 0.02, 0.03, 0.045])
_FEW = 8


class Told(Protocol):
    """What is left of a torque, as mean logarithms: in each block by the others (blocks,), and inside the fit."""

    @property
    def blocks(self) -> FloatArray: ...  # noqa: D102

    @property
    def inside(self) -> float: ...  # noqa: D102


@dataclass(frozen=True)
class Delay:
    """Seconds by which the torque is late, whether that is a mistake, and what is left of it with and without."""

    seconds: float
    is_mistake: bool
    left_with: float
    left_without: float

    @property
    def is_at_the_end(self) -> bool:
        """Whether it is the largest that was tried: what explains more then need not be a delay."""
        return abs(self.seconds) >= float(_TRIED.max())


def delay_of(
    motion: Motion, period: float, left_of: Callable[[Motion], Told], left_beside: Callable[[Motion], Told]
) -> Delay | None:
    """Find the delay with which the robot explains most; None where the rows are too few.

    Parameters
    ----------
    motion : all filtered rows, in their order
    period : s between rows
    left_of : function
        Tells what is left of the torque of a motion.
    left_beside : function
        The same beside a constant torque on each joint.
    """
    if len(motion.q) < _FEW:
        return None
    rows = np.arange(len(motion.q), dtype=np.float64)
    torque = make_interp_spline(rows, motion.tau, k=3)

    def moved(seconds: float) -> Motion:
        return replace(motion, tau=torque(np.clip(rows + seconds / period, 0.0, rows[-1])))

    tried = [left_of(moved(float(seconds))) for seconds in _TRIED]
    seconds = _lowest(np.array([one.blocks.mean() for one in tried]))
    inside = np.array([one.inside for one in tried])
    now, then = tried[int(np.flatnonzero(_TRIED == 0.0)[0])], left_of(moved(seconds))
    fall = now.blocks - then.blocks
    error = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    sure = float(fall.mean()) >= max(CLEARLY, SURELY * error) and now.inside - inside.min() >= INSIDE * fall.mean()
    mistaken = sure and not _can_be(seconds) and not _can_be(_lowest(inside))
    if mistaken:
        beside = (left_beside(motion).blocks - left_beside(moved(seconds)).blocks).mean()
        mistaken = beside >= BESIDE_OFFSETS * fall.mean()
    return Delay(seconds, bool(mistaken), float(np.exp(now.blocks.mean())), float(np.exp(then.blocks.mean())))


def _can_be(seconds: float) -> bool:
    return EARLIEST <= seconds <= LATEST


def _lowest(left: FloatArray) -> float:
    """The delay with which least is left, of what is left with those that were tried."""
    best = int(np.argmin(left))
    if best in (0, len(_TRIED) - 1):
        return float(_TRIED[best])
    x, y = (one[best - 1 : best + 2] for one in (_TRIED, left))
    # Where a parabola through three points is lowest.
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-0.5 * b / a, x[0], x[-1])) if a > 0 else float(x[1])
