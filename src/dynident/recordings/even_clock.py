"""Time stamps with few digits: is the clock behind them even?"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray

_FINEST = 1e-9
"""s: steps that differ by less are the same."""

_WHOLE = 0.02
"""Share of a tick by which a step may be off a whole number of ticks."""

_ROUNDING = 1.01
"""Ticks that two rounded stamps can be off together, and what their binary digits add."""


@dataclass(frozen=True)
class EvenClock:
    """All stamps are whole `tick`s, and within one tick of an even clock with this `period`, both in s.

    Nothing in such stamps says that samples came at other times than the even clock's, and taking them at their word
    would shake every moving joint by speed times tick.
    """

    period: float
    tick: float

    def restore_times(self, t: FloatArray, start: float) -> FloatArray:
        """Return when rows stamped t (m,) were sampled, counted from a row at `start`."""
        return np.asarray(start + np.round((t - start) / self.period) * self.period)


@dataclass
class EvenClockScan:
    """Narrows down the period of an even clock, stamp by stamp."""

    _tick: float = 0.0
    _usual: float = 0.0
    _lowest: float = 0.0
    _highest: float = np.inf
    _start: float = 0.0
    _behind: float = 0.0
    _count: int = 0
    _possible: bool = True

    def feed(self, t: FloatArray, begins: BoolArray) -> None:
        """Take the next stamps t (m,), and which of them begin an unbroken run."""
        if not self._possible or not len(t):
            return
        if not self._tick:
            steps = np.diff(t)[~begins[1:]]
            self._tick = _find_tick(steps)
            # The mean: between two ticks the median is far from the period. Lost samples change it little.
            self._usual = float(steps[steps > 0].mean()) if self._tick else 0.0
            self._possible = self._tick > 0.0
            if not self._possible:
                return
        for first, last in _split_runs(begins):
            part = t[first:last]
            if begins[first]:
                self._start, self._behind, self._count = float(part[0]), float(part[0]), 0
            steps = np.round(np.diff(np.concatenate([[self._behind], part])) / self._usual)
            number = self._count + np.cumsum(steps)
            self._behind, self._count = float(part[-1]), int(number[-1])
            later = number > 0
            # The k-th row after the start lies within a tick of k periods: each stamp bounds the period from both
            # sides, the later the closer.
            elapsed, room = part[later] - self._start, _ROUNDING * self._tick
            if len(elapsed):
                self._lowest = max(self._lowest, float(((elapsed - room) / number[later]).max()))
                self._highest = min(self._highest, float(((elapsed + room) / number[later]).min()))
            if self._lowest > self._highest:
                self._possible = False
                return

    def result(self) -> EvenClock | None:
        """Return the clock; None if the stamps are no rounded ones of an even clock."""
        if not self._possible or not self._tick or not np.isfinite(self._highest):
            return None
        return EvenClock(0.5 * (self._lowest + self._highest), self._tick)


def _find_tick(steps: FloatArray) -> float:
    """Return what all steps are whole multiples of: their smallest difference; 0 if there is none."""
    steps = steps[steps > 0]
    if not len(steps):
        return 0.0
    distinct = np.unique(np.round(steps / _FINEST)) * _FINEST
    if len(distinct) < 2:
        return 0.0
    tick = float(np.diff(distinct).min())
    whole = distinct / tick
    return tick if bool((np.abs(whole - np.round(whole)) <= _WHOLE).all()) else 0.0


def _split_runs(begins: BoolArray) -> list[tuple[int, int]]:
    """Return (first, last + 1) of the parts that begin anew, and of what comes before the first of them."""
    edges = [0, *(int(k) for k in np.flatnonzero(begins) if k), len(begins)]
    return list(itertools.pairwise(edges))
