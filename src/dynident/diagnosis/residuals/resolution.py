"""What filtered positions can still resolve where a joint reverses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.diagnosis.comparing.compare import Comparison
from dynident.effects import ShapeSpec
from dynident.recordings import Preprocessing
from dynident.robot.model import FloatArray

_SHARE_OF_SPEED = 0.5


@dataclass(frozen=True, eq=False)
class Resolution:
    """Smallest displacement (n,) and speed (n,) around a reversal that a low-passed position still shows.

    A joint that reverses with acceleration a is within a/(2πf)² of its turning point, and slower than a/(2πf), for as
    long as a filter with cut-off f takes to answer. What friction does inside that (sticking, above all) is there in
    the torque but not in q: a slip distance or Stribeck velocity below it would be fitted to the filter, not to the
    robot.
    """

    displacement: FloatArray
    speed: FloatArray

    def shows(self, spec: ShapeSpec, value: float, joints: Sequence[int]) -> bool:
        """Whether a shape constant is large enough to be seen on these joints."""
        if spec.resolved_by is None or not len(joints):
            return True
        limit = self.displacement if spec.resolved_by == "displacement" else self.speed
        return value >= float(np.max(limit[list(joints)]))


def resolution(comparisons: Sequence[Comparison], preprocessing: Preprocessing) -> Resolution:
    """What recordings filtered like this can resolve, from the accelerations at their reversals."""
    cutoffs = [f for f in (preprocessing.position_cutoff, preprocessing.torque_cutoff) if f is not None]
    n = len(comparisons[0].joint_names)
    if not cutoffs:
        return Resolution(np.zeros(n), np.zeros(n))
    corner = 2 * np.pi * min(cutoffs)
    acceleration = np.array([_at_reversals(comparisons, j) for j in range(n)])
    return Resolution(acceleration / corner**2, _SHARE_OF_SPEED * acceleration / corner)


def _at_reversals(comparisons: Sequence[Comparison], joint: int) -> float:
    """Median acceleration of a joint where its velocity changes sign; 0 where it never does."""
    found = [np.abs(c.ddq[:-1, joint][np.diff(np.sign(c.dq[:, joint])) != 0]) for c in comparisons if len(c.t) > 1]
    values = np.concatenate(found) if found else np.zeros(0)
    return float(np.median(values)) if len(values) else 0.0
