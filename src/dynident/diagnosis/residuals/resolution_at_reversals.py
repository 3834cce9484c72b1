"""How narrow a speed or distance filtered positions still resolve near reversals: limits for shape constants.

Holds up to which share of the fastest motion a friction peak is a peak (0.5).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.effects import ShapeSpec
from dynident.recordings import Preprocessing
from dynident.recordings.joint_phases import Phase

_SLOWEST_SHARE = 0.02
"""Share of a joint's moving rows that have to be slower than a speed for what happens below it to show."""

_WIDEST = 0.5
"""Share of a joint's largest speed from which on a peak at low speed is none any more."""

_NEAREST_SHARE = 0.1
"""Share of a joint's moving rows that have to be nearer to its last halt than a slip distance for that to show."""

_SHARP_TURNS = 0.5
"""Of the free reversals so many have to be gentle enough."""


@dataclass(frozen=True, eq=False)
class Resolution:
    """Smallest displacement, travel since a halt and speed that the rows which count can show.

    A joint that reverses with acceleration a is within a/(2πf)² of its turning point for as long as a filter with
    cut-off f takes to answer. What friction does inside that (sticking, above all) is there in the torque but not in q:
    a slip distance below it would be fitted to the filter, not to the robot. Only reversals at which the joint does not
    stick count, since only their rows do; or the distances from the last halt at which rows where the joint moves
    begin. And what depends on the speed alone shows in rows where the joint moves, so
    that a speed must be above the slowest of these.

    Parameters
    ----------
    displacement : (n,)
        Smallest slip distance that shows where a joint reverses, rad or m.
    travel : (n,)
        Smallest travel since a halt that shows, rad or m.
    speed : (n,)
        Smallest speed that shows, rad/s or m/s.
    fastest : (n,)
        Largest speed of all rows, rad/s or m/s.
    """

    displacement: FloatArray
    travel: FloatArray
    speed: FloatArray
    fastest: FloatArray

    def is_resolved(self, spec: ShapeSpec, value: float, joints: Sequence[int], within: float = 1.0) -> bool:
        """Return whether a shape constant is large enough to be seen on some joints."""
        if spec.resolved_by is None or not len(joints):
            return True
        limit = {"displacement": self.displacement, "travel": self.travel, "speed": self.speed}[spec.resolved_by]
        # A peak that is as wide as the joint is fast is no peak but a slope.
        if spec.resolved_by == "speed" and value > _WIDEST * float(np.max(self.fastest[list(joints)])):
            return False
        return within * value >= float(np.max(limit[list(joints)]))


def compute_resolution(comparisons: Sequence[Comparison], preprocessing: Preprocessing) -> Resolution:
    """Compute what recordings filtered like this can resolve, from the accelerations at their reversals."""
    cutoffs = [f for f in (preprocessing.position_cutoff, preprocessing.torque_cutoff) if f is not None]
    n = len(comparisons[0].joint_names)
    if not cutoffs:
        return Resolution(np.zeros(n), np.zeros(n), np.zeros(n), np.full(n, np.inf))
    # The lower cut-off decides: whatever one of the filters hides cannot show.
    corner = 2 * np.pi * min(cutoffs)
    acceleration = np.array([_compute_reversal_acceleration(comparisons, j) for j in range(n)])
    travelled = np.array([_compute_nearest_travel(comparisons, j) for j in range(n)])
    fastest = np.max([np.abs(c.dq).max(axis=0) for c in comparisons], axis=0)
    speed = np.array([_compute_slowest_speed(comparisons, j) for j in range(n)])
    return Resolution(np.minimum(acceleration / corner**2, travelled), travelled, speed, fastest)


def _compute_reversal_acceleration(comparisons: Sequence[Comparison], joint: int) -> float:
    """Return the median acceleration of a joint where it reverses freely; infinite where it never does."""
    accelerations = []
    for c in comparisons:
        turns = np.flatnonzero(np.diff(np.sign(c.dq[:, joint])) != 0)
        accelerations.append(np.abs(c.ddq[turns[c.phase[turns, joint] == Phase.REVERSING], joint]))
    values = np.concatenate(accelerations)
    return float(np.quantile(values, _SHARP_TURNS)) if len(values) else np.inf


def _compute_nearest_travel(comparisons: Sequence[Comparison], joint: int) -> float:
    """Return the distance from the last halt within which few of the moving rows lie; infinite without any."""
    distances = []
    for c in comparisons:
        moving = c.moving[:, joint]
        new = np.diff(c.segment, prepend=-1.0) != 0
        # The index of the last row at rest, carried forward; a new segment has no halt behind it.
        last = np.maximum.accumulate(np.where(~moving | new, np.arange(len(moving)), 0))
        rows = np.flatnonzero(moving & ~moving[last])
        distances.append(np.abs(c.q[rows, joint] - c.q[last[rows], joint]))
    values = np.concatenate(distances)
    return float(np.quantile(values, _NEAREST_SHARE)) if len(values) else np.inf


def _compute_slowest_speed(comparisons: Sequence[Comparison], joint: int) -> float:
    """Return the speed below which a small share of a joint's moving rows lie; infinite where it never moves."""
    rows_of = [c.off_halts[:, joint] & (c.free[joint] | (c.phase[:, joint] != Phase.REVERSING)) for c in comparisons]
    values = np.concatenate([np.abs(c.dq[rows, joint]) for c, rows in zip(comparisons, rows_of, strict=True)])
    return float(np.quantile(values, _SLOWEST_SHARE)) if len(values) else np.inf
