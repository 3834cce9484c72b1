"""Examine the time column: rate, jitter, gaps, repeated or reversed stamps.

Holds what a gap is (5 periods), and when a clock is hopeless.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.errors import Remedy
from dynident.number_format import format_percent
from dynident.recordings.file_source import RawRows, describe_bursts, find_bursts
from dynident.recordings.recording_metadata import Check, RecordingError, Revision
from dynident.recordings.units import format_time

_FINEST = 1e-9
"""s: steps that differ by less are the same."""

_WHOLE = 0.02
"""Share of a tick by which a step may be off a whole number of ticks."""

_ROUNDING = 1.01
"""Ticks that two rounded stamps can be off together, and what their binary digits add."""


@dataclass(frozen=True)
class EvenClock:
    """An even clock whose stamps were rounded: they are whole ticks, and within one tick of it.

    Nothing in such stamps says that samples came at other times than the even clock's, and taking them at their word
    would shake every moving joint by speed times tick.

    Parameters
    ----------
    period : float
        Step of the clock in s.
    tick : float
        Resolution of its stamps in s.
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
            # In whole periods: where samples are lost a step is several of them.
            steps = np.round(np.diff(np.concatenate([[self._behind], part])) / self._usual)
            number = self._count + np.cumsum(steps)
            self._behind, self._count = float(part[-1]), int(number[-1])
            later = number > 0
            # The k-th row after the start lies within a tick of k periods: each stamp bounds the period from both
            # sides, the later the closer.
            elapsed, tolerance = part[later] - self._start, _ROUNDING * self._tick
            if len(elapsed):
                self._lowest = max(self._lowest, float(((elapsed - tolerance) / number[later]).max()))
                self._highest = min(self._highest, float(((elapsed + tolerance) / number[later]).min()))
            # No period agrees with all stamps: they are not those of an even clock.
            if self._lowest > self._highest:
                self._possible = False
                return

    def result(self) -> EvenClock | None:
        """Return the clock; None if the stamps are no rounded ones of an even clock."""
        # Runs of a single row leave the period without an upper bound.
        if not self._possible or not self._tick or not np.isfinite(self._highest):
            return None
        return EvenClock(0.5 * (self._lowest + self._highest), self._tick)


def _find_tick(steps: FloatArray) -> float:
    """Return what all steps are whole multiples of: their smallest difference; 0 if there is none."""
    steps = steps[steps > 0]
    if not len(steps):
        return 0.0
    distinct = np.unique(np.round(steps / _FINEST)) * _FINEST
    # Steps that are all equal need no clock in their place: they are even as they are.
    if len(distinct) < 2:
        return 0.0
    tick = float(np.diff(distinct).min())
    whole = distinct / tick
    return tick if bool((np.abs(whole - np.round(whole)) <= _WHOLE).all()) else 0.0


def _split_runs(begins: BoolArray) -> list[tuple[int, int]]:
    """Return (first, last + 1) of the parts that begin anew, and of what comes before the first of them."""
    edges = [0, *(int(k) for k in np.flatnonzero(begins) if k), len(begins)]
    return list(itertools.pairwise(edges))


BACKWARD_SHARE = 0.9
"""Share of the steps of t that go back from which on the rows are in reverse order, and not only some exchanged."""

GAP_PERIODS = 5.0
"""A longer step of t than so many nominal periods is a gap: nothing is interpolated or filtered across it."""

REGULAR_SHARE = 0.85
"""Where so many of the steps agree with their median, it is the rate of a clock that loses samples."""

HOPELESS_SPREAD = 0.7
"""Standard deviation of the steps, in periods, above which interpolation invents the motion."""

MOST_MISSING = 0.3
"""Share of the time that gaps may take where what lies between them is short."""

EDGES, MOST_AT_EDGES = 2.0, 0.5
"""s about a gap that filters take, and the share of the rows that may lie there: long runs with pauses between them are
as good as runs in files of their own."""

LONGEST_PERIOD = 0.5
"""s: rows farther apart cannot show a robot's motion; the time is then mostly in another unit."""
_SMALLER_UNITS = (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))

_MEDIAN_ROWS = 65536
_KEPT_GAPS = 20


@dataclass(frozen=True)
class Gap:
    """A step of t that is too long.

    Parameters
    ----------
    row : int
        Data row, counted from 1, after which it begins.
    start : float
        Time of that row in s.
    length : float
        Seconds to the next row.
    """

    row: int
    start: float
    length: float


@dataclass(frozen=True)
class TimeBase:
    """What is known of a recording's time after the first pass.

    Parameters
    ----------
    n_rows : int
        Number of data rows.
    first, last : float
        Earliest and latest time in s.
    period : float
        Nominal step in s, of which the sampling rate is the inverse.
    typical : float
        Median of the first steps in s.
    shortest, longest : float
        Shortest and longest step in s that is no gap.
    deviation : float
        Standard deviation of these steps in s.
    gaps : tuple of Gap
        The first gaps.
    n_gaps : int
        Number of all gaps.
    missing : float
        Share of the time that is in gaps.
    n_repeated : int
        Number of rows that repeat the stamp before them.
    first_repeated : int or None
        The first of these data rows, counted from 1.
    worst_row : int
        Data row, counted from 1, whose step is farthest from the typical one.
    even : EvenClock, optional
        The clock that was rounded to these stamps, if there is one.
    """

    n_rows: int
    first: float
    last: float
    period: float
    typical: float
    shortest: float
    longest: float
    deviation: float
    gaps: tuple[Gap, ...]
    n_gaps: int
    missing: float
    n_repeated: int
    first_repeated: int | None
    worst_row: int
    even: EvenClock | None = None

    @property
    def longest_step(self) -> float:
        """The longest step of t in s that is no gap."""
        return GAP_PERIODS * self.typical


@dataclass
class TimeScan:
    """Collects the steps of t; feed it every block in order, then ask for the result."""

    name: str
    _typical: float = 0.0
    _waiting: list[tuple[IntArray, FloatArray, FloatArray]] = field(default_factory=list)
    _n_waiting: int = 0
    _n_rows: int = 0
    _first: float = np.inf
    _last: float = -np.inf
    _previous: tuple[float, int] | None = None
    _sums: FloatArray = field(default_factory=lambda: np.zeros(3))
    _near: FloatArray = field(default_factory=lambda: np.zeros(2))
    _range: tuple[float, float] = (np.inf, 0.0)
    _worst: tuple[float, int] = (-1.0, 0)
    _gaps: list[Gap] = field(default_factory=list)
    _n_gaps: int = 0
    _in_gaps: float = 0.0
    _n_repeated: int = 0
    _first_repeated: int | None = None
    _even: EvenClockScan = field(default_factory=EvenClockScan)
    _stamps: list[tuple[FloatArray, BoolArray]] = field(default_factory=list)

    def feed(self, rows: RawRows) -> None:
        """Take the next rows.

        Raises
        ------
        RecordingError
            For a stamp that is no number or that goes back in time within a segment.
        """
        t, segment = rows.t, rows.segment
        if not len(t):
            return
        bad = np.flatnonzero(~np.isfinite(t))
        if len(bad):
            row = rows.first_row + int(bad[0]) + 1
            raise RecordingError(
                f"Column {self.name} has no number in row {row}; every row needs a time. Remove the row, or repair "
                "its time stamp.",
                pointer=self.name,
                title="Time is not a number",
                row=row,
            )
        # The last row of the block before comes in front: the step between two blocks counts like any other.
        if self._previous is not None:
            t = np.concatenate([[self._previous[0]], t])
            segment = np.concatenate([[self._previous[1]], segment])
        ends = np.arange(rows.first_row + len(rows.t) - len(t) + 2, rows.first_row + len(rows.t) + 1)
        steps, same = np.diff(t), np.diff(segment) == 0
        self._refuse_unsorted(steps, same, t, ends)
        repeated = same & (steps == 0)
        if repeated.any() and self._first_repeated is None:
            self._first_repeated = int(ends[repeated][0])
        self._n_repeated += int(repeated.sum())
        self._n_rows += len(rows.t)
        self._first, self._last = min(self._first, float(rows.t.min())), max(self._last, float(rows.t.max()))
        self._previous = float(rows.t[-1]), int(rows.segment[-1])
        # The very first row begins a run; the first one of a later block only where its segment differs.
        self._stamps.append((rows.t, np.concatenate([np.ones(len(rows.t) - len(same), dtype=bool), ~same])))
        # A repeated stamp is no step of the clock; its row is left out later.
        forward = same & (steps > 0)
        self._waiting.append((ends[forward], t[:-1][forward], steps[forward]))
        self._n_waiting += int(forward.sum())
        # The typical step is the median of the first many: until then steps wait.
        if self._typical or self._n_waiting >= _MEDIAN_ROWS:
            self._sort_steps()

    def result(self) -> TimeBase:
        """Return what was found.

        Raises
        ------
        RecordingError
            If there are too few rows to tell a rate.
        """
        self._sort_steps()
        total, n, squares = self._sums
        if self._n_rows < 2 or n < 1:
            raise RecordingError(
                f"The file has only {self._n_rows} rows of data at different times; these are too few for a recording.",
                pointer=self.name,
                title="Too short",
            )
        near_total, n_near = self._near
        # A clock that loses samples now and then has the rate of its usual step; else the mean over all steps counts.
        period = near_total / n_near if n_near >= REGULAR_SHARE * n else total / n
        even = self._even.result()
        if even is not None:
            # All stamps together bound the period of an even clock much closer than the mean of their rounded steps
            # does.
            period = even.period
        # Where all steps are equal the difference of these sums may round to less than zero.
        variance = max(0.0, squares / n - (total / n) ** 2)
        return TimeBase(
            n_rows=self._n_rows,
            first=self._first,
            last=self._last,
            period=float(period),
            typical=self._typical,
            shortest=self._range[0],
            longest=self._range[1],
            deviation=float(np.sqrt(variance)),
            gaps=tuple(self._gaps),
            n_gaps=self._n_gaps,
            missing=self._in_gaps / (self._in_gaps + float(total)),
            n_repeated=self._n_repeated,
            first_repeated=self._first_repeated,
            worst_row=self._worst[1],
            even=even,
        )

    def _refuse_unsorted(self, steps: FloatArray, same: BoolArray, t: FloatArray, ends: IntArray) -> None:
        back = np.flatnonzero(same & (steps < 0))
        if not len(back):
            return
        at, row = int(back[0]), int(ends[back[0]])
        remedy = Remedy("rate")
        cure = (
            f"If each row has its own time, sort the rows by it; if only the times are wrong, state {remedy}. "
            "Separate several recordings in one file by a column `segment` of whole numbers."
        )
        if (steps[same] < 0).mean() > BACKWARD_SHARE:
            cure = (
                f"All the rows are in reverse order: write the earliest first; of a countdown state {remedy} instead."
            )
        raise RecordingError(
            f"Column {self.name} goes back from {format_time(t[at])} s to {format_time(t[at + 1])} s in row {row}. "
            f"{cure}",
            pointer=self.name,
            title="Unsorted time",
            row=row,
            time=float(t[at + 1]),
            remedies=(remedy,),
        )

    def _sort_steps(self) -> None:
        """Sort the waiting steps into ordinary ones and gaps."""
        if not self._waiting:
            return
        ends, starts, steps = (np.concatenate(parts) for parts in zip(*self._waiting, strict=True))
        self._waiting, self._n_waiting = [], 0
        if not len(steps):
            return
        if not self._typical:
            # The median: gaps and lost samples hardly move it.
            self._typical = float(np.median(steps))
        # A gap begins a new run of the even clock, too: how many samples are missing in it cannot be told from rounded
        # stamps.
        for t, begins in self._stamps:
            self._even.feed(t, begins | (np.diff(t, prepend=t[0]) > GAP_PERIODS * self._typical))
        self._stamps = []
        wide = steps > GAP_PERIODS * self._typical
        self._n_gaps += int(wide.sum())
        self._in_gaps += float(steps[wide].sum())
        for at in np.flatnonzero(wide)[: max(0, _KEPT_GAPS - len(self._gaps))]:
            self._gaps.append(Gap(int(ends[at]) - 1, float(starts[at]), float(steps[at])))
        ordinary = steps[~wide]
        if not len(ordinary):
            return
        self._sums += (ordinary.sum(), len(ordinary), (ordinary**2).sum())
        # Of the steps that agree with the usual one: their mean is the period of a clock that loses samples.
        near = ordinary[np.abs(ordinary - self._typical) <= 0.05 * self._typical]
        self._near += (near.sum(), len(near))
        self._range = min(self._range[0], float(ordinary.min())), max(self._range[1], float(ordinary.max()))
        # Gaps are reported by themselves: here they count as 0.
        off = np.abs(steps - self._typical) * ~wide
        if off.max() > self._worst[0]:
            self._worst = float(off.max()), int(ends[off.argmax()])


def check_time(base: TimeBase, column: str, *, are_pauses: bool) -> list[Check]:
    """Report jitter, gaps and repeated stamps of the time column; pauses at standstill are no lost samples."""
    return [_check_jitter(base, column), _check_gaps(base, column, are_pauses), _check_repeated(base, column)]


def _check_jitter(base: TimeBase, column: str) -> Check:
    rate = 1.0 / base.period
    spread = base.deviation / base.period
    if base.period > LONGEST_PERIOD:
        # The coarsest of the smaller units in which the rows are close enough for a motion.
        unit = next((name for name, size in _SMALLER_UNITS if base.period * size <= LONGEST_PERIOD), "ms")
        remedy = Remedy("units", {"t": unit})
        return Check(
            "sampling_jitter",
            "error",
            f"The rows are {base.period:.4g} s of {column} apart, too far apart to show motion. If {column} is in "
            f"{unit}, state {remedy}.",
            column,
            1,
            base.first,
            Revision(units={"t": unit}),
            remedies=(remedy,),
        )
    if spread > HOPELESS_SPREAD:
        return Check(
            "sampling_jitter",
            "error",
            f"Steps of {column} run from {1e3 * base.shortest:.3g} to {1e3 * base.longest:.3g} ms (standard deviation "
            f"{format_percent(spread, 2)} of the period; farthest off in row {base.worst_row}): the sampling is too "
            "irregular, and the motion between the rows is lost. Log at a fixed rate.",
            column,
            base.worst_row,
            base.first,
        )
    if base.even is not None:
        return Check(
            "sampling_jitter",
            "ok",
            f"Sampled at {rate:.5g} Hz: the time stamps have a resolution of {1e3 * base.even.tick:.3g} ms and agree "
            "with an even clock within it; the even clock is used instead of them.",
        )
    if spread < 0.02 and base.longest < 1.5 * base.period and base.shortest > 0.5 * base.period:
        return Check(
            "sampling_jitter", "ok", f"Sampled at {rate:.5g} Hz, with equal steps within {format_percent(spread, 2)}."
        )
    return Check(
        "sampling_jitter",
        "warning",
        f"Steps of {column} run from {1e3 * base.shortest:.3g} to {1e3 * base.longest:.3g} ms (standard deviation "
        f"{format_percent(spread, 2)} of the period; farthest off in row {base.worst_row}); resampled onto a uniform "
        f"grid of {rate:.5g} Hz by cubic interpolation. If possible, log with a steady clock and take the time stamp "
        "when the sample is measured, not when it is written.",
        column,
        base.worst_row,
    )


def _check_gaps(base: TimeBase, column: str, are_pauses: bool) -> Check:
    if not base.n_gaps:
        return Check("gaps", "ok", f"No step of t is longer than {GAP_PERIODS:g} periods.")
    first = base.gaps[0]
    # Long pauses alone do no harm. Too little is left only where the filters' edges take most of what lies between.
    if base.missing > MOST_MISSING and EDGES * base.n_gaps > MOST_AT_EDGES * base.n_rows * base.period:
        ends, times = np.array([gap.row for gap in base.gaps]), np.array([gap.start for gap in base.gaps])
        burst, rate = find_bursts(ends, times, base.typical)
        words = [describe_bursts(column, burst, rate)] if burst else []
        advice = f"{words[0][0]} Or record" if words else "Record"
        return Check(
            "gaps",
            "error",
            f"Gaps take {format_percent(base.missing, 2)} of the time (gaps: {base.n_gaps}); the first is "
            f"{first.length:.4g} s long, after t = {format_time(first.start)} s (row {first.row}). Too few samples are "
            f"left. {advice} without dropping samples, or choose windows without gaps.",
            column,
            first.row,
            first.start,
            remedies=tuple(remedy for _, remedy in words),
        )
    more = f" and {base.n_gaps - 1} more (the next at {format_time(base.gaps[1].start)} s)" if base.n_gaps > 1 else ""
    start = f"t = {format_time(first.start)} s (row {first.row})"
    pause = f"There are no samples for {first.length:.4g} s after {start}{more}"
    detail = f"{pause}, while the robot stands. The recording is split there, like files of their own."
    if not are_pauses:
        detail = (
            f"{pause}. The recording is split there, and no filter runs across the gap; the filter loses about a "
            "second on either side. If possible, record without dropping samples."
        )
    return Check("gaps", "ok" if are_pauses else "warning", detail, column, first.row, first.start)


def _check_repeated(base: TimeBase, column: str) -> Check:
    if not base.n_repeated:
        return Check("repeated_time", "ok", "No time stamp occurs twice.")
    return Check(
        "repeated_time",
        "warning",
        f"{base.n_repeated} rows repeat the time stamp of the row before (the first is row {base.first_repeated}); "
        "they are left out. The logger writes faster than the robot sends new values, or its stamps have few digits.",
        column,
        base.first_repeated,
    )
