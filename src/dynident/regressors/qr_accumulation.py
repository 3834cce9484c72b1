"""Accumulate rows of recordings into triangular factors by equation and block; length of blocks, most values kept."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.estimation import FactorAccumulator, IntervalRowAccumulator, Reduction, concatenate_reductions
from dynident.parallel import map_in_threads, map_sequentially
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording

# Blocks of time: at least and at most so many seconds long, about so many of a recording, and never more than so
# many.
_SHORTEST, _LONGEST, _SHARE, _MOST = 0.25, 2.0, 20, 100

MOST_VALUES = 4_000_000
"""Entries that are kept of one data set at most, 32 MB: twenty minutes of recording at a usual decimation."""


@dataclass(frozen=True, eq=False)
class RestRows:
    """Rows at rest of one equation.

    Parameters
    ----------
    upper, lower : (m, p)
        W where the joint stands, with the friction of either direction.
    y : (m,)
        Y there.
    """

    upper: FloatArray
    lower: FloatArray
    y: FloatArray


@dataclass(frozen=True, eq=False)
class EquationRows:
    """Rows of one segment, equation by equation.

    Parameters
    ----------
    t : (m,)
        Times, s.
    rows : list of (m, p + 1)
        [W | Y] of every equation.
    segment : int
        Number of the segment.
    used : (m, equations), optional
        Which rows of which equation count; all of them where it is left out.
    beside : list of RestRows, optional
        Rows at rest of every equation.
    """

    t: FloatArray
    rows: list[FloatArray]
    segment: int
    used: BoolArray | None = None
    beside: list[RestRows] | None = None


def choose_block_length(recordings: Sequence[Recording]) -> float:
    """Return the length in s of the blocks of time that factors are kept for.

    A twentieth of the data, but long against the correlation of filtered rows and short against the motion, and never
    so many that their factors would outgrow the data's own size.

    Parameters
    ----------
    recordings : sequence of Recording
        The data that will be accumulated.

    Returns
    -------
    float
        Seconds.
    """
    duration = sum(compute_used_duration(recording) for recording in recordings)
    # The limit on the number of blocks wins over the longest length: memory grows with their number.
    return float(max(np.clip(duration / _SHARE, _SHORTEST, _LONGEST), duration / _MOST))


def compute_used_duration(recording: Recording) -> float:
    """Return the seconds of a recording that are inside its windows."""
    total = 0.0
    for segment in recording.segments:
        start, end = segment.start_time, segment.start_time + segment.length * recording.period
        if recording.windows:
            total += sum(max(0.0, min(end, last) - max(start, first)) for first, last in recording.windows)
        else:
            total += end - start
    return total


def accumulate_equations(
    rows_of: Callable[[Recording], Iterable[EquationRows]],
    columns: Sequence[IndexArray],
    n_columns: int,
    recordings: Sequence[Recording],
    progress: Progress = ignore_progress,
    beside: bool = False,
    *,
    in_turn: bool = False,
    by_time: bool = True,
) -> Reduction:
    """Accumulate the equations that `rows_of` makes of every recording, of large recordings several at a time.

    Parameters
    ----------
    rows_of : function
        Makes the rows of a recording. Unless recordings go `in_turn`, threads call it at once for several of them.
    columns : sequence of (p,)
        The parameters that each equation contains.
    n_columns : int
        Number of all parameters.
    recordings : sequence of Recording
        The data.
    progress : Progress
        Hears of the share that is done.
    beside : bool
        Whether rows at rest are kept as well.
    in_turn : bool
        Whether the rows of one recording depend on those before, as a filter's do that goes on from one to the next.
    by_time : bool
        Whether there is a factor for each block of time, or only one for each segment.

    Returns
    -------
    Reduction
        The blocks of all recordings, in the order of these.
    """
    block_length = choose_block_length(recordings) if by_time else math.inf
    fold_recording = EquationAccumulator(rows_of, tuple(columns), n_columns, block_length, beside)
    sizes = [recording.n_samples for recording in recordings]
    # Recordings are independent of each other, so that large ones run side by side.
    return concatenate_reductions(
        (map_sequentially if in_turn else map_in_threads)(fold_recording, recordings, sizes, progress)
    )


@dataclass(frozen=True, eq=False)
class EquationAccumulator:
    """Accumulates the equations of one recording.

    Parameters
    ----------
    rows_of : function
        Makes the rows of a recording.
    columns : tuple of (p,)
        The parameters that each equation contains.
    n_columns : int
        Number of all parameters.
    block_length : float
        Length of the blocks of time that have a factor each, s.
    beside : bool
        Whether rows at rest are kept as well.
    """

    rows_of: Callable[[Recording], Iterable[EquationRows]]
    columns: tuple[IndexArray, ...]
    n_columns: int
    block_length: float
    beside: bool

    def __call__(self, recording: Recording, progress: Progress) -> Reduction:
        """Return the factors of a recording."""
        accumulator = FactorAccumulator(self.columns, self.n_columns, self.block_length)
        rest_accumulators = [IntervalRowAccumulator(len(own)) for own in self.columns] if self.beside else []
        segment, start = -1, recording.segments[0].start_time
        duration = recording.n_samples * recording.period
        for part in self.rows_of(recording):
            if part.segment != segment:
                # A block of time never spans two segments: between them time is missing.
                accumulator.end_block()
                segment = part.segment
            # Rows at rest take no part in the fit. They are kept beside the factors, for errors over all samples.
            accumulator.push(part.t, part.rows, part.used)
            for rest_accumulator, rows in zip(rest_accumulators, part.beside or (), strict=False):
                rest_accumulator.push(rows.upper, rows.lower, rows.y)
            progress(min(1.0, float(part.t[-1] - start) / duration), recording.name)
        return _attach_rest_rows(accumulator.finish(), rest_accumulators)


def _attach_rest_rows(reduction: Reduction, rest_accumulators: Sequence[IntervalRowAccumulator]) -> Reduction:
    """Return the reduction with the rows at rest of every equation."""
    if not rest_accumulators:
        return reduction
    equations = tuple(
        replace(e, separate_rows=b.finish()) for e, b in zip(reduction.equations, rest_accumulators, strict=True)
    )
    return replace(reduction, equations=equations)
