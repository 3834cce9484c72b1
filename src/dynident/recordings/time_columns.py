"""Read time columns: text, seconds with nanoseconds, steps of time, clocks that start again."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pyarrow as pa

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.arrow_tables import from_numbers, to_floats
from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.file_source import FileSource, RawRows, RawSource, Repair, to_float_column
from dynident.recordings.recording_metadata import Check
from dynident.recordings.units import SECONDS_OF_DAY, format_time, parse_seconds

NEAR_BEGINNING = 0.1
"""Share of the time since a run began, from its beginning on, to which a clock goes back that starts again."""

FEWEST_STEPS = 20.0
"""Steps that such a clock goes back at least; rows that are exchanged go back by fewer."""


NEAR_MIDNIGHT = 60.0
"""s before and behind midnight between two rows of one run."""


@dataclass
class ClockOfDay:
    """Reads times of day, block by block; a clock without a date begins at 0 again at midnight, where they go on."""

    _days: int = 0
    _last: float = np.nan

    def parse(self, column: pa.Array) -> pa.Array:
        """Return written times as float64: seconds since the midnight before the first."""
        t = to_floats(parse_seconds(column)).copy()
        timed = np.isfinite(t)
        steps = np.nan_to_num(np.diff(t[timed], prepend=self._last))
        if len(steps):
            self._last = float(t[timed][-1])
            # A row of the day before that was written behind midnight goes back by a day.
            passed = np.abs(np.abs(steps) - SECONDS_OF_DAY) < NEAR_MIDNIGHT
            days = self._days - np.cumsum(np.sign(steps) * passed)
            self._days = int(days[-1])
            t[timed] += SECONDS_OF_DAY * days
        return from_numbers(t)


@dataclass
class RunLabels:
    """Numbers the runs of a file, block by block.

    A run begins where the time starts again, and where the clock is put back: it then goes on evenly on both sides,
    while rows that are in a wrong order are reached by a jump forward.
    """

    restarts: list[tuple[int, float, float]] = field(default_factory=list)
    """Data row, from 1, and the times before it and in it."""
    _begin: float = np.nan
    _last: float = np.nan
    _step: float = 0.0
    _jump: int = -1
    """Row of the file, from 0, that was last reached by a jump forward."""

    def label_rows(self, first_row: int, t: FloatArray) -> IntArray:
        """Return the number of the run of each row (m,), from 0."""
        labels = np.full(len(t), len(self.restarts), dtype=np.int64)
        if not len(t):
            return labels
        # Before the first row of all stands NaN: no comparison with it is true.
        before = np.concatenate([[self._last], t[:-1]])
        steps = t - before
        forward = steps[steps > 0.0]
        if not self._step and len(forward):
            self._step = float(np.median(forward))
        if np.isnan(self._begin):
            self._begin = float(t[0])
        # Where no step goes forward the whole file runs backward: it has no runs.
        restarts = np.flatnonzero(steps < -FEWEST_STEPS * self._step) if self._step else ()
        jumps = np.flatnonzero(steps > FEWEST_STEPS * self._step) if self._step else np.empty(0, dtype=np.int64)
        for row in restarts:
            earlier = jumps[jumps < row]
            jump = first_row + int(earlier[-1]) if len(earlier) else self._jump
            overlap = (before[row] - t[row]) / self._step + FEWEST_STEPS
            # Back to near the beginning of the run: rows that were only exchanged, or written late, go back less far.
            if t[row] <= self._begin + NEAR_BEGINNING * (before[row] - self._begin) or (
                first_row + int(row) - jump > overlap and jump < first_row + int(row)
            ):
                self.restarts.append((first_row + int(row) + 1, float(before[row]), float(t[row])))
                self._begin = float(t[row])
                labels[row:] = len(self.restarts)
        if len(jumps):
            self._jump = first_row + int(jumps[-1])
        self._last = float(t[-1])
        return labels


class RestartingSource:
    """A file whose rows are numbered by run where its time starts again and no column tells the runs apart."""

    def __init__(self, source: RawSource) -> None:
        self._source = source
        self._labels = RunLabels()
        self._without_time: list[int] = []
        self._has_begun = False

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Yield t and the runs alone; values are empty."""
        yield from self._label_blocks(self._source.times(layout), layout)

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Yield everything that the layout names."""
        yield from self._label_blocks(self._source.rows(layout), layout)

    def checks(self, column: str) -> list[Check]:
        """Report where the time started again, after its rows were read."""
        restarts = self._labels.restarts
        without = self._report_rows_without_time(column)
        if not restarts:
            return without
        row, before, time = restarts[0]
        more = f", and later again ({len(restarts)} times in all)" if len(restarts) > 1 else ""
        detail = (
            f"Column {column} goes back from {format_time(before)} to {format_time(time)} s in row {row}{more}: "
            f"the file is read as {len(restarts) + 1} segments, and no filter runs across their borders. A column "
            "`segment` of whole numbers also separates segments."
        )
        rows = {column: tuple(restart[0] for restart in restarts)}
        return [*without, Check("time_restarts", "warning", detail, column, row, time, rows=rows)]

    def _label_blocks(self, blocks: Iterator[RawRows], layout: Layout) -> Iterator[RawRows]:
        # The file is read more than once: each pass counts anew.
        self._labels = RunLabels()
        self._without_time = []
        self._has_begun = False
        for block in blocks:
            rows = self._cut_ends(block)
            if not len(rows.t):
                continue
            labels = rows.segment if layout.segment is not None else self._labels.label_rows(rows.first_row, rows.t)
            yield rows._replace(segment=labels)

    def _cut_ends(self, rows: RawRows) -> RawRows:
        """Return the rows without those at either end that have no time: means below a table, rows never written."""
        unfilled = find_unfilled(rows.t, self._has_begun)
        self._has_begun |= bool(np.nan_to_num(rows.t).any())
        good = np.flatnonzero(np.isfinite(rows.t) & ~unfilled)
        if len(good) == len(rows.t) or (not len(good) and not unfilled.all()):
            return rows
        first, last = (int(good[0]), int(good[-1]) + 1) if len(good) else (0, 0)
        numbers = [*range(first), *range(last, len(rows.t))]
        if np.count_nonzero(~unfilled[numbers]) > MOST_WITHOUT_TIME * len(rows.t):
            return rows
        self._without_time += [rows.first_row + number + 1 for number in numbers]
        part = slice(first, last)
        return RawRows(rows.first_row + first, rows.t[part], rows.segment[part], rows.values[part])

    def _report_rows_without_time(self, column: str) -> list[Check]:
        if not self._without_time:
            return []
        first = self._without_time[0]
        count = f"{len(self._without_time)} rows have" if len(self._without_time) > 1 else "1 row has"
        detail = (
            f"{count} no number in {column}, or 0 as where nothing was written, the first is row {first}: left out."
        )
        return [Check("rows_left_out", "warning", detail, column, first, rows={column: tuple(self._without_time)})]


def find_unfilled(t: FloatArray, has_begun: bool = False) -> BoolArray:
    """Return which rows (m,) were never written: their times are 0, and so are those beside them.

    Parameters
    ----------
    t : (m,)
        Consecutive times.
    has_begun : bool
        Whether another time than 0 stands above them.
    """
    zero = t == 0.0
    # The rows of another block may be beside the first and the last.
    beside = np.concatenate([[True], zero, [True]])
    begun = has_begun | (np.cumsum(~zero) > 0)
    n_before = int(np.count_nonzero(~begun))
    # A clock that begins at 0 may stay there for a few rows, where these are written several times.
    head = ~begun & (_LONGEST_START < n_before < len(t))
    return np.asarray(zero & (begun & (beside[:-2] | beside[2:]) | head))


_LONGEST_START = 5
"""Rows at time 0 with which a file may begin."""


MOST_WITHOUT_TIME = 0.01
"""Share of the rows that may stand without a time at the ends of a file."""


_NAME = re.compile(
    r"(?:^|[^a-z])(?:t|time|timestamp|stamp|zeit|secs?|seconds)(?:[ _.]*[\[(]?(?:s|secs?|seconds|ms|us|µs|ns)[\])]?)?$",
    re.IGNORECASE,
)


def is_time_name(name: str) -> bool:
    """Return whether a column's name is that of a time."""
    return _NAME.search(name) is not None


def describe_foreign_clock(name: str, span: tuple[float, float], main: str, main_span: tuple[float, float]) -> str:
    """Say that signals are left out, because no moment of their clock is one of the recording's."""
    return (
        f"The times of {name} ({span[0]:.10g} to {span[1]:.10g}) and {main} ({main_span[0]:.10g} to "
        f"{main_span[1]:.10g}) have no moment in common: {name} is left out. Write both with the time of one clock."
    )


_TIME = "t"


_INCREMENT = re.compile(
    r"(?:^|[^a-z])(?:d_?t|δt|delta[ _]?t(?:ime)?|time[ _]?(?:delta|diff)|diff[ _]?time)"
    r"(?P<unit>[ _.]*[\[(]?(?:s|secs?|ms|us|µs|ns)[\])]?)?$",
    re.IGNORECASE,
)
_RISING = 0.9
"""Share of steps upward from which a column so called counts from the beginning, and not from the row before."""


class SummedTimeSource(FileSource):
    """A file whose rows have the time since the row before them: `t` is their sum, in the same unit."""

    def __init__(self, source: FileSource, increment: str) -> None:
        self._source, self._increment = source, increment
        match = _INCREMENT.search(increment)
        unit = re.sub(r"[ _.\[\]()]", "", (match and match["unit"]) or "")
        unit = source.units.get(increment, "s" if unit.startswith("sec") else unit)
        super().__init__([_TIME, *source.names], {**source.units, **({_TIME: unit} if unit else {})})
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.inner, self.clocks = source.has_gaps, source, source.clocks
        self.own_remarks = (f"{increment} is the time since the previous row: t is its sum.",)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed = [self._increment if name == _TIME else name for name in columns]
        total, first_row = 0.0, 0
        for batch in self._source.batches(list(dict.fromkeys(needed))):
            values = {name: batch.column(name) for name in needed}
            if _TIME in columns:
                # A step that is missing counts as none: the row has then the time of the one before.
                steps = np.nan_to_num(to_float_column(batch, self._increment, first_row))
                t = total + np.cumsum(steps)
                total, values[_TIME] = float(t[-1]) if len(t) else total, from_numbers(t)
            yield pa.RecordBatch.from_arrays([values[name] for name in columns], names=columns)
            first_row += batch.num_rows


def repair_times(source: FileSource) -> FileSource:
    """Return the file with a time that rises, where it has only steps of one or lost digits; else the same object."""
    return _restore_fractions(_sum_increments(source))


def _sum_increments(source: FileSource) -> FileSource:
    """Return the file with a time where its rows have only that since the row before; else the same object."""
    increments = [name for name in source.names if _INCREMENT.search(name)]
    others = [name for name in source.names if name not in increments and is_time_name(name)]
    if len(increments) != 1 or others or _TIME in source.names:
        return source
    (increment,) = increments
    first = next(source.batches(increments), None)
    values = np.empty(0) if first is None else to_float_column(first, increment, 0)
    values = values[np.isfinite(values)]
    is_clock = len(values) < 2 or bool((np.diff(values) > 0).mean() > _RISING)
    return source if is_clock or not np.median(values) > 0 else SummedTimeSource(source, increment)


class PaddedFractionSource(FileSource):
    """A file whose time lost the zeros behind its point, as "%d.%d" prints seconds and nanoseconds; they are put back.

    5 ms behind a second, 1.005, is printed as 1.5: each stamp is divided by the power of ten that brings it next to
    where the clock has to be.
    """

    def __init__(self, source: FileSource, name: str, period: float) -> None:
        super().__init__(source.names, source.units)
        self._source, self._name, self._period = source, name, period
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.inner, self.clocks = source.has_gaps, source, source.clocks
        lost = f'{name} lost the zeros behind its point, as "%d.%d" prints seconds and nanoseconds: they are put back.'
        self.own_remarks = (Repair(lost),)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        before, first_row = np.nan, 0
        for batch in self._source.batches(columns):
            values = {name: batch.column(name) for name in columns}
            if self._name in columns and batch.num_rows:
                t = pad_fractions(to_float_column(batch, self._name, first_row), self._period, before)
                values[self._name] = from_numbers(t)
                before = float(np.append(before, t[np.isfinite(t)])[-1])
            yield pa.RecordBatch.from_arrays([values[name] for name in columns], names=columns)
            first_row += batch.num_rows


_DIGITS, _OFF = 9, 5.0
"""Digits of the smallest fraction; and periods by which a stamp may be off where the clock has to be."""


def pad_fractions(t: FloatArray, period: float, before: float = np.nan) -> FloatArray:
    """Return times (m,) with the zeros behind the point that they lost.

    Parameters
    ----------
    t : (m,)
        Consecutive times, s.
    period : float
        Their usual step, s.
    before : float
        The last finite time before them; nan where they begin.
    """
    padded, is_finite = t.copy(), np.isfinite(t)
    known = np.where(is_finite, t, 0.0)
    for row, (whole, part) in enumerate(zip(np.floor(known).tolist(), np.mod(known, 1.0).tolist(), strict=True)):
        if not is_finite[row]:
            continue
        stamps = [whole + part / 10.0**zeros for zeros in range(_DIGITS)]
        if np.isnan(before) and is_finite[row + 1 : row + 2].any():
            # Which of them the first is, its distance from the next tells.
            later, rest = float(np.floor(t[row + 1])), float(t[row + 1] % 1.0)
            ahead = [later + rest / 10.0**zeros - period for zeros in range(_DIGITS)]
            before = min(stamps, key=lambda own: min(abs(own - stamp) for stamp in ahead)) - period
        stamp = min(
            (own for own in stamps if own >= before), key=lambda own: abs(own - before - period), default=t[row]
        )
        # Behind a gap nothing tells it: an order that is then wrong is refused.
        padded[row] = before = stamp if abs(stamp - before - period) <= _OFF * period else float(t[row])
    return padded


def _restore_fractions(source: FileSource) -> FileSource:
    """Return the file with the zeros that its time lost behind the point; else the same object."""
    names = [name for name in source.names if is_time_name(name)]
    first = next(source.batches(names[:1]), None) if names else None
    if first is None:
        return source
    t = to_float_column(first, names[0], 0)
    steps = np.diff(t)
    # Of fractions of right times a tenth is below 0.1. Where no step goes back nothing is wrong.
    fractions = np.mod(t, 1.0)
    if not np.isfinite(t).all() or not (steps < 0.0).any() or ((fractions > 0.0) & (fractions < _LEAST)).any():
        return source
    period = float(np.median(steps))
    mended = np.diff(pad_fractions(t, period))
    is_even = bool((mended >= 0.0).all()) and np.mean(np.abs(mended - period) < 0.5 * period) > _RISING
    return PaddedFractionSource(source, names[0], period) if is_even else source


_LEAST = 0.1 - 1e-6
"""Fraction below which a time has a zero behind the point, with what seconds since 1970 are rounded by."""


_FRACTION = re.compile(
    r"^(?P<whose>.*?)(?P<part>nano|micro|milli|n|u|µ|m)[_ ]?(?:secs?|seconds|s)(?P<end>[\])]?)$", re.IGNORECASE
)
_PARTS = {"n": 1e-9, "u": 1e-6, "µ": 1e-6, "mi": 1e-6, "m": 1e-3}
_WORDS = ("sec", "secs", "seconds", "s")


def find_stamp_pairs(names: Sequence[str]) -> dict[str, tuple[str, str, float]]:
    """Return pairs of columns, and what the second counts, by their common name.

    `stamp.sec` and `stamp.nanosec` are `stamp.time`, `Time[s]` and `Time[ns]` are `Time`; microseconds and milliseconds
    likewise.
    """
    pairs: dict[str, tuple[str, str, float]] = {}
    plain = {name.casefold(): name for name in names}
    for name in names:
        match = _FRACTION.match(name)
        if match is None:
            continue
        # Nanoseconds alone are a time as well: only beside seconds of the same name are they a part of one.
        stem = match["whose"].casefold()
        seconds = (f"{stem}{word}{match['end']}" for word in _WORDS)
        whole = next((plain[candidate] for candidate in seconds if candidate in plain), None)
        ours = match["whose"].rstrip(" [(_") if match["end"] else f"{match['whose']}time"
        if whole is not None and ours not in names and ours not in pairs:
            part = match["part"].casefold()
            pairs[ours] = whole, name, _PARTS["mi" if part == "micro" else part[0]]
    return pairs


_MILLISECONDS = re.compile(r"milli(?:tm|s|sec\w*)?|msecs?", re.IGNORECASE)


def _find_milliseconds(source: FileSource) -> dict[str, tuple[str, str, float]]:
    """Return the pair of a time of day in whole seconds and a column of its milliseconds, if the file has such."""
    parts = [name for name in source.names if _MILLISECONDS.fullmatch(name)]
    times = [name for name in source.names if is_time_name(name) and name not in parts]
    if len(parts) != 1 or len(times) != 1 or _TIME in source.names:
        return {}
    first = next(source.batches([*times, *parts]), None)
    if first is None:
        return {}
    whole, part = (to_float_column(first, name, 0) for name in (*times, *parts))
    is_part = bool(((part >= 0.0) & (part < 1e3)).all() and (whole == np.round(whole)).all())
    # The milliseconds begin anew with each second; beside a stamp that has them already they do not.
    steps = np.diff(whole)
    is_next = steps == 1.0
    is_clock = bool(is_next.any() and (is_next | (steps == 0.0)).all() and (np.diff(part)[is_next] < 0.0).all())
    return {_TIME: (times[0], parts[0], 1e-3)} if is_part and is_clock else {}


_OF_STAMPS = re.compile(r"(?:^|[./])(?:secs? nanosecs?|secs nsecs)$", re.IGNORECASE)
"""The fields of a stamp of ROS, one behind the other: they are never a time each."""
_MOST_ROWS = 0.9
"""Share of the rows that decides: a damaged one among them is no other kind of time."""


def _is_split(source: FileSource, whole: str, part: str, scale: float) -> bool:
    """Tell whether a column has whole seconds, and another one less than a second: each may be a whole time."""
    if _OF_STAMPS.search(f"{whole} {re.split('[./]', part)[-1]}"):
        return True
    first = next(source.batches([whole, part]), None)
    if first is None:
        return False
    seconds, rest = (to_float_column(first, name, 0) for name in (whole, part))
    has_both = np.isfinite(seconds) & np.isfinite(rest)
    seconds, rest = seconds[has_both], scale * rest[has_both]
    are_parts = (seconds == np.round(seconds)) & (rest >= 0.0) & (rest <= 1.0)
    return not len(are_parts) or bool(are_parts.mean() >= _MOST_ROWS)


class SplitStampSource(FileSource):
    """A file with the joined time of two columns in front of the others."""

    def __init__(self, source: FileSource, pairs: dict[str, tuple[str, str, float]]) -> None:
        self._source, self._pairs = source, pairs
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.inner, self.clocks = source.has_gaps, source, source.clocks
        # Milliseconds of a time of day are no signal: beside the joined time they are left out.
        parts = {part for name, (_, part, _) in pairs.items() if name == _TIME}
        names = [name for name in source.names if name not in parts]
        super().__init__([*pairs, *names], {**source.units, **dict.fromkeys(pairs, "s")})

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed = [column for name in columns for column in (self._pairs[name][:2] if name in self._pairs else (name,))]
        first_row = 0
        for batch in self._source.batches(list(dict.fromkeys(needed))):
            values = [
                self._join_stamps(batch, name, first_row) if name in self._pairs else batch.column(name)
                for name in columns
            ]
            yield pa.RecordBatch.from_arrays(values, names=columns)
            first_row += batch.num_rows

    def _join_stamps(self, batch: pa.RecordBatch, name: str, first_row: int) -> pa.Array:
        whole, part = (to_float_column(batch, column, first_row) for column in self._pairs[name][:2])
        return from_numbers(whole + self._pairs[name][2] * part)


def join_split_stamps(source: FileSource) -> FileSource:
    """Return the file with its time joined, if it stands in two columns; else the same object."""
    pairs = find_stamp_pairs(source.names)
    pairs = {name: pair for name, pair in pairs.items() if _is_split(source, *pair)} or _find_milliseconds(source)
    return SplitStampSource(source, pairs) if pairs else source
