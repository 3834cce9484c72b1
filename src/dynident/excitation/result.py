"""What comes back of a design."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray, IntArray
from dynident.excitation.criteria.baseline import Baseline
from dynident.excitation.criteria.expected import ExpectedParameter
from dynident.excitation.criteria.values import CriterionValues
from dynident.excitation.request import DesignRequest
from dynident.motion.limits.margins import Margin
from dynident.motion.surroundings.reach import FLOOR_ALONE, NOTHING_STATED
from dynident.robot.collision import UNCHECKED

_WARNINGS = (UNCHECKED, NOTHING_STATED, FLOOR_ALONE)
"""How notes begin that say what was not checked."""
_HAIR = 1e-9


@dataclass(frozen=True)
class Run:
    """One test motion of a set: what it is for, the joints that move, and from when to when (s)."""

    label: str
    joints: tuple[str, ...]
    start: float
    end: float


@dataclass(frozen=True, eq=False)
class Design:
    """A verified experiment: t (N,), q, dq, ddq (N, n) at the sampling rate, from home to home.

    `exciting` are the times (s) between which the exciting part lies; `period` is its period, `None` where it has
    none. `baseline` is what random trajectories reach, `None` where there is nothing to compare. `margins` tell how
    near every limit comes, on a grid ten times as fine. `parameter_names` are the base parameters it was designed for,
    `expected` how well each of them will come out. `runs` are the test motions of a set, one after the other.
    """

    joint_names: tuple[str, ...]
    request: DesignRequest
    t: FloatArray
    q: FloatArray
    dq: FloatArray
    ddq: FloatArray
    exciting: tuple[float, float]
    period: float | None
    parameter_names: tuple[str, ...]
    criterion_values: CriterionValues
    baseline: Baseline | None
    margins: tuple[Margin, ...]
    notes: tuple[str, ...]
    expected: tuple[ExpectedParameter, ...] = ()
    runs: tuple[Run, ...] = ()

    def __repr__(self) -> str:
        return (
            f"Design({self.request.kind}: {len(self.joint_names)} joints, {self.n_samples} samples at "
            f"{self.sampling_rate:g} Hz, {self.duration:.4g} s, condition number "
            f"{self.criterion_values.condition_number:.4g})"
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """The notes without which nobody should run the motion."""
        return tuple(note for note in self.notes if note.startswith(_WARNINGS))

    @property
    def n_samples(self) -> int:
        """Number of samples N."""
        return len(self.t)

    @property
    def segments(self) -> IntArray:
        """Number (N,) of the run that a sample belongs to, from 1 on; 0 outside of all runs."""
        number = np.zeros(len(self.t), dtype=np.int64)
        for index, run in enumerate(self.runs):
            number[(self.t >= run.start - _HAIR) & (self.t <= run.end + _HAIR)] = index + 1
        return number

    @property
    def sampling_rate(self) -> float:
        """Hz."""
        return self.request.trajectory.sampling_rate

    @property
    def duration(self) -> float:
        """Seconds from home to home."""
        return float(self.t[-1])
