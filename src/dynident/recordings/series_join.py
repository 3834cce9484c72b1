"""Join series of samples with clocks of their own on the time of one of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dynident.array_types import FloatArray

_LONGEST_STEP = 10.0
"""Usual steps of a series beyond which it is not read between its samples."""
_PATIENCE = 8
"""Blocks of samples after which a series that has fallen silent is not waited for."""


class SampleSeries:
    """The samples of one series that are still needed.

    Parameters
    ----------
    names : sequence of str
        Names of its columns.
    step : float
        Its usual step of time in s.
    """

    def __init__(self, names: Sequence[str], step: float) -> None:
        self.names, self._step = tuple(names), step
        self._places = {name: index for index, name in enumerate(names)}
        self._times, self._rows = np.empty(0), np.empty((0, len(self.names)))

    def __len__(self) -> int:
        return len(self._times)

    @property
    def latest(self) -> float:
        """The time of the last sample."""
        return float(self._times[-1])

    def add(self, times: FloatArray, names: Sequence[str], values: FloatArray) -> None:
        """Append samples: times (m,), and values (m, c) of the named columns; others are ignored."""
        rows = np.full((len(times), len(self.names)), np.nan)
        positions = [index for index, name in enumerate(names) if name in self._places]
        rows[:, [self._places[names[index]] for index in positions]] = values[:, positions]
        self._times = np.concatenate([self._times, times])
        self._rows = np.concatenate([self._rows, rows])

    def take(self, until: float) -> tuple[FloatArray, FloatArray]:
        """Return the samples up to a time, and forget them."""
        count = int(np.searchsorted(np.maximum.accumulate(self._times), until, side="right"))
        times, rows = self._times[:count], self._rows[:count]
        self._times, self._rows = self._times[count:], self._rows[count:]
        return times, rows

    def read_at(self, stamps: FloatArray) -> FloatArray:
        """Return the values at times (m,), by a straight line between the samples; NaN if there are none near."""
        result = np.full((len(stamps), len(self.names)), np.nan)
        if not len(self):
            return result
        order = np.argsort(self._times, kind="stable")
        # Stamps of different sources may come a little out of order.
        times, rows = self._times[order], self._rows[order]
        after = np.clip(np.searchsorted(times, stamps), 0, len(times) - 1)
        before = np.maximum(after - 1, 0)
        longest = _LONGEST_STEP * max(self._step, 1e-9)
        # The distance to the nearest sample outside the series, else the gap between the two samples around.
        near = np.where(
            stamps > times[-1],
            stamps - times[-1],
            np.where(stamps < times[0], times[0] - stamps, times[after] - times[before]),
        )
        for index in range(len(self.names)):
            result[:, index] = np.interp(stamps, times, rows[:, index])
        # Over a long gap, or beyond the ends, a straight line would invent the signal.
        result[near > longest] = np.nan
        return result

    def forget(self, before: float) -> None:
        """Forget the samples before the last one that is at most at this time."""
        count = int(np.searchsorted(self._times, before, side="right")) - 1
        if count > 0:
            self._times, self._rows = self._times[count:], self._rows[count:]


class JoinedSamples(NamedTuple):
    """Times (m,), and the values (m, c) of every series at them."""

    times: FloatArray
    values: dict[str, FloatArray]


class TimeJoin:
    """Reads series at the samples of one of them.

    Parameters
    ----------
    series : mapping of str to SampleSeries
        The series by name; samples are added to them in the order of time.
    main : str
        The series whose samples are the rows.
    block_samples : int
        Samples of the main series that are joined at once.
    """

    def __init__(self, series: Mapping[str, SampleSeries], main: str, block_samples: int) -> None:
        self._series, self._main, self._block_samples = series, main, block_samples

    def add(self, series: str, times: FloatArray, names: Sequence[str], values: FloatArray) -> None:
        """Append samples of a series: times (m,), and values (m, c) of the named columns."""
        self._series[series].add(times, names, values)

    @property
    def is_full(self) -> bool:
        """Whether the main series has samples for a block."""
        return len(self._series[self._main]) >= self._block_samples

    def rows(self, *, last: bool = False) -> JoinedSamples:
        """Return the rows up to the time that every series has reached, and forget them.

        Parameters
        ----------
        last : bool
            Whether no more samples follow: then all rows are returned.

        Returns
        -------
        JoinedSamples
            Times, and the values of all series at them.
        """
        main = self._series[self._main]
        # A series that has ended or fallen silent must not hold up all others.
        is_stalled = len(main) >= _PATIENCE * self._block_samples
        latest = [other.latest for other in self._series.values() if len(other)]
        until = np.inf if last or is_stalled or not latest else min(latest)
        times, rows = main.take(until)
        values = {self._main: rows}
        for name, other in self._series.items():
            if other is not main:
                values[name] = other.read_at(times)
                if len(times):
                    # The sample before the next row is still needed, to interpolate from.
                    other.forget(float(times[-1]))
        return JoinedSamples(times, values)
