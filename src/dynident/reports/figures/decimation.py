"""Long series for figures: few points, all extremes, and gaps where nothing was measured."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.arrays import BoolArray, FloatArray
from dynident.diagnosis import Comparison

_GAP = 1.5
_PAUSE = 0.02


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """Where the samples of a comparison stand on paper.

    `t` (m,) increases all along: runs that overlap in time are set one after another (`shifted`). `stretches` are the
    slices without a gap.
    """

    t: FloatArray
    stretches: tuple[slice, ...]
    shifted: bool

    @property
    def label(self) -> str:
        """What to write at the axis."""
        return "time, runs one after another (s)" if self.shifted else "time (s)"

    def only(self, rows: BoolArray) -> TimeAxis:
        """The same with its stretches cut to those of the rows (m,) that are wanted."""
        changes = np.flatnonzero(np.diff(rows)) + 1
        pieces: list[slice] = []
        for part in self.stretches:
            inner = changes[(changes > part.start) & (changes < part.stop)].tolist()
            pieces += [slice(a, b) for a, b in pairwise([part.start, *inner, part.stop]) if rows[a]]
        return replace(self, stretches=tuple(pieces))


def time_axis(comparison: Comparison) -> TimeAxis:
    """The axis of a comparison's samples."""
    t = comparison.t.copy()
    steps = np.diff(t)
    forward = steps[(steps > 0) & (np.diff(comparison.segment) == 0)]
    usual = float(np.median(forward)) if len(forward) else 0.0
    broken = (np.diff(comparison.segment) != 0) | (steps <= 0) | (steps > _GAP * usual)
    borders = [0, *(np.flatnonzero(broken) + 1).tolist(), len(t)]
    stretches = tuple(slice(first, last) for first, last in pairwise(borders) if last > first)
    shifted = False
    pause = _PAUSE * sum(float(t[part][-1] - t[part][0]) for part in stretches)
    for before, after in pairwise(stretches):
        if t[after.start] <= t[before.stop - 1]:
            t[after.start :] += t[before.stop - 1] + max(pause, usual) - t[after.start]
            shifted = True
    return TimeAxis(t, stretches, shifted)


def thinned(axis: TimeAxis, values: FloatArray, points: int) -> tuple[FloatArray, FloatArray]:
    """About `points` of the series (m,), with the extremes of every part of it, and NaN between stretches.

    Returns
    -------
    t, values : arrays of the same length
    """
    t, found = thinned_together(axis, points, values)
    return t, found


def thinned_together(axis: TimeAxis, points: int, *series: FloatArray) -> tuple[FloatArray, ...]:
    """The same of several series (m,) at common times, with the extremes of each."""
    total = len(axis.t)
    parts: list[list[FloatArray]] = [[] for _ in range(len(series) + 1)]
    for part in axis.stretches:
        length = part.stop - part.start
        bins = max(1, round(0.5 * points * length / total))
        kept = part.start + np.unique(np.concatenate([extremes(values[part], bins) for values in series]))
        for k, values in enumerate((axis.t, *series)):
            if parts[k]:
                parts[k].append(axis.t[kept[:1]] if k == 0 else np.array([np.nan]))
            parts[k].append(values[kept])
    return tuple(np.concatenate(part) if part else np.empty(0) for part in parts)


def extremes(values: FloatArray, bins: int) -> NDArray[np.intp]:
    """Indices, ascending, of the first and last value and of the least and largest of each of `bins` equal parts."""
    m = len(values)
    if m <= 2 * bins + 2:
        return np.arange(m)
    size = -(-m // bins)
    padded = np.concatenate([values, np.full(size * bins - m, values[-1])]).reshape(bins, size)
    first = np.arange(bins) * size
    found = np.concatenate([[0, m - 1], first + padded.argmin(axis=1), first + padded.argmax(axis=1)])
    return np.unique(np.minimum(found, m - 1))
