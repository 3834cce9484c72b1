"""Decimation of long series for figures: few points, all extremes, and gaps where nothing was measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray
from dynident.diagnosis import Comparison

# A step in time above so many usual steps is a gap, in which no line is drawn.
_GAP_RATIO = 1.5
# Between segments that are set one after another, a share of the whole time.
_PAUSE_SHARE = 0.02


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """The positions of a comparison's samples on the time axis of a figure.

    Attributes
    ----------
    t : (m,) array
        Increases throughout: segments that overlap in time are set one after another.
    stretches : tuple of slice
        Samples without a gap between them.
    shifted : bool
        True where segments were set one after another.
    """

    t: FloatArray
    stretches: tuple[slice, ...]
    shifted: bool

    @property
    def label(self) -> str:
        """The text at the axis."""
        return "time, runs one after another (s)" if self.shifted else "time (s)"

    def restrict(self, rows: BoolArray) -> TimeAxis:
        """Return the axis with its stretches cut down to some of the rows.

        Parameters
        ----------
        rows : (m,) array of bool
            Which samples remain.

        Returns
        -------
        TimeAxis
            The same times, with other stretches.
        """
        # The stretches are cut wherever `rows` changes; each piece then is wanted, or not, as a whole.
        changes = np.flatnonzero(np.diff(rows)) + 1
        pieces: list[slice] = []
        for part in self.stretches:
            inner = changes[(changes > part.start) & (changes < part.stop)].tolist()
            pieces += [slice(a, b) for a, b in pairwise([part.start, *inner, part.stop]) if rows[a]]
        return replace(self, stretches=tuple(pieces))


def build_time_axis(comparison: Comparison) -> TimeAxis:
    """Return the time axis of a comparison's samples.

    Parameters
    ----------
    comparison : Comparison
        Measured and predicted torque.

    Returns
    -------
    TimeAxis
        The axis of all samples.
    """
    t = comparison.t.copy()
    steps = np.diff(t)
    # Decimated segments may differ in their step; the median step within segments is the usual one.
    forward = steps[(steps > 0) & (np.diff(comparison.segment) == 0)]
    usual_step = float(np.median(forward)) if len(forward) else 0.0
    broken = (np.diff(comparison.segment) != 0) | (steps <= 0) | (steps > _GAP_RATIO * usual_step)
    borders = [0, *(np.flatnonzero(broken) + 1).tolist(), len(t)]
    stretches = tuple(slice(first, last) for first, last in pairwise(borders) if last > first)
    shifted = False
    pause = _PAUSE_SHARE * sum(float(t[part][-1] - t[part][0]) for part in stretches)
    for before, after in pairwise(stretches):
        # Only what would lie on top of the stretch before it is moved, together with all that follows.
        if t[after.start] <= t[before.stop - 1]:
            t[after.start :] += t[before.stop - 1] + max(pause, usual_step) - t[after.start]
            shifted = True
    return TimeAxis(t, stretches, shifted)


def thin_series(axis: TimeAxis, values: FloatArray, points: int) -> tuple[FloatArray, FloatArray]:
    """Thin out a series to some points, with the extremes of every part of it and NaN between stretches.

    Parameters
    ----------
    axis : TimeAxis
        Where the samples stand on the time axis.
    values : (m,) array
        Values of all samples.
    points : int
        About how many remain.

    Returns
    -------
    t, values : (k,)
        Times and values of the points that remain.
    """
    t, thin_values = thin_series_together(axis, points, values)
    return t, thin_values


def thin_series_together(axis: TimeAxis, points: int, *series: FloatArray) -> tuple[FloatArray, ...]:
    """Thin out several series at common times, with the extremes of each.

    Parameters
    ----------
    axis : TimeAxis
        Where the samples stand on the time axis.
    points : int
        About how many remain of each series.
    series : tuple of (m,)
        Values of all samples, of one series each.

    Returns
    -------
    tuple of arrays
        The times, then each series, all of the same length.
    """
    total = len(axis.t)
    parts: list[list[FloatArray]] = [[] for _ in range(len(series) + 1)]
    for part in axis.stretches:
        length = part.stop - part.start
        # Two extremes of each part are kept, so that half as many parts give the number of points.
        bins = max(1, round(0.5 * points * length / total))
        # The series share their times, so that an area between two of them can be filled.
        rows = part.start + np.unique(np.concatenate([find_extremes(values[part], bins) for values in series]))
        for k, values in enumerate((axis.t, *series)):
            # A NaN breaks the line between stretches; its time has to be a number.
            if parts[k]:
                parts[k].append(axis.t[rows[:1]] if k == 0 else np.array([np.nan]))
            parts[k].append(values[rows])
    return tuple(np.concatenate(part) if part else np.empty(0) for part in parts)


def find_extremes(values: FloatArray, bins: int) -> NDArray[np.intp]:
    """Return the indices of the first, last, least and largest values of equal parts of a series.

    Parameters
    ----------
    values : (m,) array
        Values of the series.
    bins : int
        Number of parts.

    Returns
    -------
    (k,) array of int
        Ascending; the first and the last of the series, and the least and the largest of every part.
    """
    m = len(values)
    if m <= 2 * bins + 2:
        return np.arange(m)
    size = -(-m // bins)
    # Repeating the last value fills the last part without a new extreme.
    padded = np.concatenate([values, np.full(size * bins - m, values[-1])]).reshape(bins, size)
    first = np.arange(bins) * size
    indices = np.concatenate([[0, m - 1], first + padded.argmin(axis=1), first + padded.argmax(axis=1)])
    return np.unique(np.minimum(indices, m - 1))
