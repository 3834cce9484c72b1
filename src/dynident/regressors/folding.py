"""Equations of recordings, folded into triangular factors as they come: one an equation and stretch of time."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.estimation import BesideAccumulator, FactorAccumulator, Reduction, concatenate
from dynident.progress import Progress, silent
from dynident.recordings import Recording
from dynident.side_by_side import one_by_one, side_by_side

_SHORTEST, _LONGEST, _SHARE, _MOST = 0.25, 2.0, 20, 100


@dataclass(frozen=True, eq=False)
class BesideRows:
    """[W | Y] of motion beside a halt; W (k, p) either way and Y (k,) where a joint stands."""

    partial: FloatArray
    upper: FloatArray
    lower: FloatArray
    y: FloatArray


@dataclass(frozen=True, eq=False)
class EquationRows:
    """Rows of one segment: t (m,), and [W | Y] (m, p + 1) of every equation.

    `used` (m, equations): which of them count, all where it is None; `beside`: what else there is to each equation.
    """

    t: FloatArray
    rows: list[FloatArray]
    segment: int
    used: BoolArray | None = None
    beside: list[BesideRows] | None = None


def stretch_length(recordings: Sequence[Recording]) -> float:
    """Length in s of the stretches that factors are kept for.

    A twentieth of the data, but long against the correlation of filtered rows and short against the motion, and never
    so many that their factors would outgrow the data's own size.
    """
    duration = sum(used_duration(recording) for recording in recordings)
    return float(max(np.clip(duration / _SHARE, _SHORTEST, _LONGEST), duration / _MOST))


def used_duration(recording: Recording) -> float:
    """Seconds of a recording that are inside its windows."""
    total = 0.0
    for segment in recording.segments:
        start, end = segment.start_time, segment.start_time + segment.length * recording.period
        if recording.windows:
            total += sum(max(0.0, min(end, last) - max(start, first)) for first, last in recording.windows)
        else:
            total += end - start
    return total


def folded(
    rows_of: Callable[[Recording], Iterable[EquationRows]],
    columns: Sequence[IndexArray],
    n_columns: int,
    recordings: Sequence[Recording],
    progress: Progress = silent,
    beside: bool = False,
    *,
    in_turn: bool = False,
) -> Reduction:
    """Fold the equations that `rows_of` makes of every recording into factors, of large ones several at a time.

    Parameters
    ----------
    rows_of : function
        Threads may call it at once, each for another recording, but where these go `in_turn`.
    columns : one (p,) array an equation
        The parameters that each equation contains.
    n_columns : int
        Number of all parameters.
    beside : bool
        Whether what is beside the equations is kept.
    in_turn : bool
        Whether the rows of one recording depend on those before, as a filter's do that goes on from one to the next.
    """
    one = Folding(rows_of, tuple(columns), n_columns, stretch_length(recordings), beside)
    sizes = [recording.n_samples for recording in recordings]
    return concatenate((one_by_one if in_turn else side_by_side)(one, recordings, sizes, progress))


@dataclass(frozen=True, eq=False)
class Folding:
    """Folds one recording as `folded` does; goes to another process where `rows_of` does.

    `stretch`: length in s of what a factor is kept for.
    """

    rows_of: Callable[[Recording], Iterable[EquationRows]]
    columns: tuple[IndexArray, ...]
    n_columns: int
    stretch: float
    beside: bool

    def __call__(self, recording: Recording, told: Progress) -> Reduction:
        """Factors of a recording."""
        accumulator = FactorAccumulator(self.columns, self.n_columns, self.stretch)
        kept = [BesideAccumulator(len(own)) for own in self.columns] if self.beside else []
        segment, start = -1, recording.segments[0].start_time
        duration = recording.n_samples * recording.period
        for part in self.rows_of(recording):
            if part.segment != segment:
                accumulator.end_stretch()
                segment = part.segment
            accumulator.push(part.t, part.rows, part.used)
            for one, rows in zip(kept, part.beside or (), strict=False):
                one.push_partial(rows.partial)
                one.push_standing(rows.upper, rows.lower, rows.y)
            told(min(1.0, float(part.t[-1] - start) / duration), recording.name)
        return _with(accumulator.finish(), kept)


def _with(reduction: Reduction, beside: Sequence[BesideAccumulator]) -> Reduction:
    if not beside:
        return reduction
    equations = tuple(replace(e, beside=b.finish()) for e, b in zip(reduction.equations, beside, strict=True))
    return replace(reduction, equations=equations)
