"""Split repaired rows at gaps and resample them to even segments; the shortest segment (8 samples)."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import floor
from typing import NamedTuple

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.errors import Remedy
from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.file_source import RawRows
from dynident.recordings.recording import Segment, are_readings
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.sampling_clock import TimeBase

SNAP = 1e-6
"""A grid point so near to a sample (in periods) takes the sample as it is."""

TOO_CLOSE = 0.25
"""Samples nearer to each other than so many periods are not put under one cubic: their noise would swing it."""


class Resampler:
    """Interpolates one gap-free segment of samples at t0, t0 + T, t0 + 2 T, …; block borders leave no trace.

    t0 is the time of the first sample, plus `lead` in s.

    Cubic (Lagrange, through the two samples on either side): a straight line would leave an error of h² q̈ / 8 in q,
    for steps of 10 ms and 5 rad/s² as large as 6e-5 rad and as rough as the jitter itself, which two differentiations
    bring to the front. Torque goes the same way, so that both are treated alike. A sample that lies on the grid is
    kept unchanged.
    """

    def __init__(self, period: float, lead: float = 0.0) -> None:
        self._period = period
        self._lead = lead
        self._t = np.empty(0)
        self._values = np.empty((0, 0))
        self._start = 0.0
        self._n_given = 0
        self._started = False

    def push(self, t: FloatArray, values: FloatArray) -> FloatArray:
        """Take samples at increasing times t (m,), values (m, c); return the grid rows that are now settled."""
        if not self._started:
            self._start, self._started = float(t[0]) + self._lead, True
            self._t, self._values = t, values
        else:
            self._t, self._values = np.concatenate([self._t, t]), np.concatenate([self._values, values])
        if len(self._t) < 4:
            return self._values[:0]
        # Settled: before the last but one sample, so that two samples stand on either side.
        count = floor((self._t[-2] - self._start) / self._period - SNAP) + 1 - self._n_given
        rows = self._interpolate_rows(count)
        # The next grid row needs two samples before it: earlier ones are forgotten.
        keep = max(0, int(np.searchsorted(self._t, self._compute_next_time(), side="right")) - 3)
        self._t, self._values = self._t[keep:], self._values[keep:]
        return rows

    def finish(self) -> FloatArray:
        """End the segment; return the grid rows up to its last sample."""
        # A hundredth of a period: rounding must not cost the last row.
        count = floor((self._t[-1] - self._start) / self._period + 0.01) + 1 - self._n_given
        return self._interpolate_rows(count)

    def _compute_next_time(self) -> float:
        return self._start + self._n_given * self._period

    def _interpolate_rows(self, count: int) -> FloatArray:
        if count <= 0:
            return self._values[:0]
        times = self._start + (self._n_given + np.arange(count, dtype=np.float64)) * self._period
        self._n_given += count
        return interpolate_samples(self._t, self._values, times, self._period)


class ShiftedResampler:
    """Resamples a segment whose torque (columns n to 2 n) is read `delay` s later than the rest of a row.

    Of servos with `gains` (n,), torque over position error, the command alone is read later, and not the position.
    """

    def __init__(self, period: float, n: int, delay: float, gains: FloatArray | None = None) -> None:
        self._n = n
        self._delay = delay
        self._gains = np.zeros(n) if gains is None else gains
        # Both parts begin at the first time of which the other one is known as well: nothing is extrapolated.
        self._rest = Resampler(period, max(0.0, -delay))
        self._torque = Resampler(period, max(0.0, delay))
        self._waiting_rest = np.empty((0, 0))
        self._waiting_torque = np.empty((0, n))

    @property
    def lead(self) -> float:
        """Seconds from the first sample to the first row."""
        return max(0.0, -self._delay)

    def push(self, t: FloatArray, values: FloatArray) -> FloatArray:
        """Take samples; return the rows of which all parts are settled."""
        torque = values[:, self._n : 2 * self._n] + self._gains * values[:, : self._n]
        others = np.delete(values, np.s_[self._n : 2 * self._n], axis=1)
        return self._join_parts(self._rest.push(t, others), self._torque.push(t, torque))

    def finish(self) -> FloatArray:
        """End the segment; return the rows that have all their parts."""
        return self._join_parts(self._rest.finish(), self._torque.finish())

    def _join_parts(self, others: FloatArray, torque: FloatArray) -> FloatArray:
        """Return the rows that both parts have reached; what is ahead waits."""
        if len(self._waiting_rest):
            others = np.concatenate([self._waiting_rest, others])
        if len(self._waiting_torque):
            torque = np.concatenate([self._waiting_torque, torque])
        count = min(len(others), len(torque))
        self._waiting_rest, self._waiting_torque = others[count:], torque[count:]
        position, rest = others[:count, : self._n], others[:count, self._n :]
        return np.concatenate([position, torque[:count] - self._gains * position, rest], axis=1)


def interpolate_samples(t: FloatArray, values: FloatArray, times: FloatArray, period: float) -> FloatArray:
    """Interpolate by cubics through two samples on either side, or by straight lines where samples are too close.

    Parameters
    ----------
    t : (m,)
        Times of the samples in s, increasing.
    values : (m, c)
        Samples of c signals.
    times : (k,)
        Times in s at which to interpolate.
    period : float
        Usual step of t in s.

    Returns
    -------
    (k, c)
        The values at these times.
    """
    m = len(t)
    if m == 1:
        return np.repeat(values, len(times), axis=0)
    right = np.clip(np.searchsorted(t, times, side="left"), 1, m - 1)
    nearest = np.where(times - t[right - 1] < t[right] - times, right - 1, right)
    on_grid = np.abs(t[nearest] - times) <= SNAP * period
    # Samples of an even clock are on the grid as they are: nothing is computed, and no digit changes.
    if on_grid.all():
        lowest = int(nearest[0])
        if np.array_equal(nearest, np.arange(lowest, lowest + len(nearest))):
            return values[lowest : lowest + len(nearest)]
        return values[nearest]
    result = _interpolate_linear(t, values, times, right)
    if m >= 4:
        # At the ends of a segment the cubic is not centred: there are no samples farther out.
        first = np.clip(right - 2, 0, m - 4)
        spread = np.diff(t)
        tight = spread < TOO_CLOSE * period
        cubic = ~(tight[first] | tight[first + 1] | tight[first + 2]) & ~on_grid
        result[cubic] = _interpolate_cubic(t, values, times[cubic], first[cubic])
    result[on_grid] = values[nearest[on_grid]]
    return result


def _interpolate_linear(t: FloatArray, values: FloatArray, times: FloatArray, right: IntArray) -> FloatArray:
    """Interpolate by straight lines; `right` is the index of the sample behind each time."""
    share = ((times - t[right - 1]) / (t[right] - t[right - 1]))[:, None]
    result: FloatArray = (1.0 - share) * values[right - 1] + share * values[right]
    return result


def _interpolate_cubic(t: FloatArray, values: FloatArray, times: FloatArray, first: IntArray) -> FloatArray:
    """Evaluate the cubic through samples first … first + 3 by Lagrange's weights."""
    knots = t[first[:, None] + np.arange(4)]
    result = np.zeros((len(times), values.shape[1]))
    for index in range(4):
        weight = np.ones(len(times))
        for other in range(4):
            if other != index:
                weight *= (times - knots[:, other]) / (knots[:, index] - knots[:, other])
        result += weight[:, None] * values[first + index]
    return result


SHORTEST = 8
"""A segment of fewer samples is left out: it is shorter than any filter."""

_FEW_REPEATED, _MOST_IN_A_ROW, _LARGEST_STEP = 0.02, 2, 3.0
"""Share of rows that repeat a time stamp, with other values, up to which they are left out; how many follow each other
then: a clock that stands still writes more; and how many times the usual largest step a position changes by: to a row
of another recording it changes by more."""


def _are_within_tick(q: FloatArray, repeats: IntArray) -> BoolArray:
    """Tell which of the rows that repeat a stamp are few in a row, with positions q (m, n) near those before them."""
    steps = np.abs(np.diff(q, axis=0, prepend=q[:1]))
    # A joint may stand most of the time: the steps that it makes count.
    moves = [step[step > 0] for step in steps.T]
    usual = _LARGEST_STEP * np.array([np.quantile(own, 0.95) if len(own) else 0.0 for own in moves])
    in_a_row = np.isin(repeats - _MOST_IN_A_ROW, repeats) & np.isin(repeats - 1, repeats)
    return np.asarray(~(steps[repeats] > usual).any(axis=1) & ~in_a_row)


class GridRows(NamedTuple):
    """Rows on the uniform grid: t (m,), the user's segment label, values (m, c)."""

    t: FloatArray
    label: int
    values: FloatArray


class Segmenter:
    """Splits and resamples rows that arrive in order.

    A new segment begins where the user's segment changes, after a gap in time, and after rows in which a needed signal
    holds no number. Rows that repeat the one before are left out. Temperatures hold their last value between readings.
    """

    def __init__(self, layout: Layout, base: TimeBase, torque_delay: float = 0.0) -> None:
        self._layout = layout
        self._base = base
        self._torque_delay = torque_delay
        needed = layout.needed_columns
        # A slice where it can be one: picking columns copies them.
        together = int(needed[-1]) + 1 == len(needed)
        self._needed: slice | IntArray = slice(0, len(needed)) if together else needed
        self._last: tuple[float, int, FloatArray] | None = None
        self._temperature: FloatArray | None = None
        self._resampler: ShiftedResampler | None = None
        self._held: list[GridRows] = []
        self._n_held = 0
        self._open: Segment | None = None
        self._closed: list[Segment] = []
        self._n_written = 0
        self._first_stamp = 0.0

    def push(self, rows: RawRows) -> Iterator[GridRows]:
        """Take the next rows; yield the grid rows that are ready to be stored."""
        values = self._hold_temperature(rows.values)
        numbers = np.all(are_readings(values[:, self._needed]), axis=1)
        new = self._mark_new_rows(rows, values)
        t, label = rows.t, rows.segment
        new_rows = np.flatnonzero(new & numbers)
        if not len(new_rows):
            # Rows without numbers end the segment; rows that only repeat the last one do not.
            if self._last is not None and not numbers.all():
                yield from self._end_segment()
                self._last = None
            return
        # A border stands before a kept row if its time jumps, its label changes, or a row without numbers lies between.
        lost = np.cumsum(~numbers)
        before_t = t[new_rows[:-1]]
        border = (t[new_rows[1:]] - before_t > self._base.longest_step) | (label[new_rows[1:]] != label[new_rows[:-1]])
        border |= lost[new_rows[1:]] != lost[new_rows[:-1]]
        first = (
            self._last is None
            or t[new_rows[0]] - self._last[0] > self._base.longest_step
            or label[new_rows[0]] != self._last[1]
            or lost[new_rows[0]] != 0
        )
        edges = [0, *(np.flatnonzero(border) + 1), len(new_rows)]
        for number, (start, end) in enumerate(pairwise(edges)):
            run = new_rows[start:end]
            if first or number:
                yield from self._end_segment()
                self._begin_segment(float(t[run[0]]), int(label[run[0]]))
            # A slice where no row is left out: it copies nothing.
            whole = slice(run[0], run[-1] + 1) if run[-1] - run[0] + 1 == len(run) else run
            yield from self._resample_rows(t[whole], values[whole])
        # Rows without numbers stand at the end of the block: what comes next is a segment of its own.
        if lost[-1] != lost[new_rows[-1]]:
            yield from self._end_segment()
            self._last = None
        else:
            # A copy: a view of this row would keep the whole block in memory.
            self._last = float(t[new_rows[-1]]), int(label[new_rows[-1]]), values[new_rows[-1]].copy()

    def finish(self) -> Iterator[GridRows]:
        """End the recording; yield the last rows."""
        yield from self._end_segment()

    def segments(self) -> tuple[Segment, ...]:
        """Return the segments that were stored."""
        return tuple(self._closed)

    def _begin_segment(self, start: float, label: int) -> None:
        layout = self._layout
        self._resampler = ShiftedResampler(self._base.period, len(layout.q), self._torque_delay, layout.servo_gains)
        self._open = Segment(self._n_written, 0, start + self._resampler.lead, label)
        self._held, self._n_held = [], 0
        self._first_stamp = start

    def _resample_rows(self, t: FloatArray, values: FloatArray) -> Iterator[GridRows]:
        assert self._resampler is not None
        if self._base.even is not None:
            # Rounded stamps of an even clock: the clock's own times are closer to the truth.
            t = self._base.even.restore_times(t, self._first_stamp)
        yield from self._store_rows(self._resampler.push(t, values))

    def _end_segment(self) -> Iterator[GridRows]:
        if self._resampler is None or self._open is None:
            return
        yield from self._store_rows(self._resampler.finish())
        # Rows that are still held were too few: their segment is dropped with them.
        if not self._n_held and self._open.length:
            self._closed.append(self._open)
        self._resampler, self._open, self._held, self._n_held = None, None, [], 0

    def _store_rows(self, values: FloatArray) -> Iterator[GridRows]:
        """Hold rows back until their segment is long enough to be worth storing."""
        if self._open is None or not len(values):
            return
        segment = self._open
        done = segment.length + self._n_held
        grid = segment.start_time + (done + np.arange(len(values), dtype=np.float64)) * self._base.period
        rows = GridRows(grid, segment.label, values)
        # Whether a segment is long enough is known only later: until then its first rows wait.
        if done + len(values) < SHORTEST:
            self._held.append(rows)
            self._n_held += len(values)
            return
        for ready in (*self._held, rows):
            yield ready
            self._n_written += len(ready.t)
        self._open = Segment(segment.first_row, done + len(values), segment.start_time, segment.label)
        self._held, self._n_held = [], 0

    def _mark_new_rows(self, rows: RawRows, values: FloatArray) -> BoolArray:
        """Mark the rows with a stamp of their own; refuse a file in which many repeat one with other content."""
        t, label = rows.t, rows.segment
        new = np.ones(len(t), dtype=bool)
        new[1:] = (np.diff(t) != 0) | (np.diff(label) != 0)
        if self._last is not None:
            new[0] = t[0] != self._last[0] or label[0] != self._last[1]
        repeats = np.flatnonzero(~new)
        if len(repeats) and self._base.n_repeated <= _FEW_REPEATED * self._base.n_rows:
            # A logger that polls writes two rows within a tick of its clock here and there.
            repeats = repeats[~_are_within_tick(values[:, self._layout.columns_of_kind("q")], repeats)]
        for row in repeats:
            # The row before may have been the last one of the block before.
            other = values[row - 1] if row else (self._last[2] if self._last is not None else values[row])
            if not np.array_equal(values[row], other, equal_nan=True):
                column = int(np.flatnonzero(values[row] != other)[0])
                name, remedy = self._layout.t.source, Remedy("rate")
                raise RecordingError(
                    f"Column {name} repeats {t[row]:.9g} s in row {rows.first_row + row + 1}, while "
                    f"{self._layout.columns[column].source} changes. Either the time stamps have too few digits "
                    f"(write more digits, or state {remedy} if the rows are evenly spaced), or the file mixes two "
                    "recordings (separate them).",
                    pointer=name,
                    title="Repeated time",
                    row=rows.first_row + int(row) + 1,
                    time=float(t[row]),
                    remedies=(remedy,),
                )
        return new

    def _hold_temperature(self, values: FloatArray) -> FloatArray:
        """Hold the last temperature where a slower thermometer left rows between its readings empty."""
        n = len(self._layout.q)
        if not self._layout.temperature:
            return values
        # Temperatures are the last of the columns.
        held = values[:, -n:].copy()
        for joint in range(n):
            readings = np.flatnonzero(np.isfinite(held[:, joint]))
            earlier = np.nan if self._temperature is None else self._temperature[joint]
            if not len(readings):
                held[:, joint] = earlier
                continue
            if np.isnan(earlier):
                # Before its first reading a thermometer is taken to have shown the same.
                earlier = held[readings[0], joint]
            # The index of the last reading up to each row, by a running maximum; -1 before the first.
            latest = np.maximum.accumulate(np.where(np.isfinite(held[:, joint]), np.arange(len(held)), -1))
            held[:, joint] = np.where(latest >= 0, held[latest, joint], earlier)
        self._temperature = held[-1] if len(held) else self._temperature
        return np.concatenate([values[:, :-n], held], axis=1)
