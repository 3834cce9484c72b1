"""Join series with clocks of their own, and sparse rows, on the time of one of them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pyarrow as pa

from dynident.array_types import BoolArray, FloatArray
from dynident.recordings.arrow_tables import batch_from_arrays
from dynident.recordings.file_size_limits import choose_block_rows
from dynident.recordings.file_source import FileSource, to_float_column
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.time_columns import describe_foreign_clock, find_stamp_pairs, is_time_name
from dynident.recordings.units import read_time_unit

_LOOKED_AT = 4000
_BLOCK_SAMPLES = 8192
_FEWEST = 8
"""Samples of a signal in the rows that are looked at, of which its pattern can be told."""
_FULL = 0.7
"""Share of its rows that a signal has, from which on the others are single samples that were lost."""
_SLOWEST = 0.03
"""Share below which a signal beside full rows is one that is held, as of a thermometer: not read between samples."""
_RUN = 20.0
"""Usual steps by which the time goes back where another run begins."""


@dataclass(frozen=True)
class _SeriesPattern:
    """The column of time, columns by series, the usual steps of each, and the one whose samples are the rows."""

    time: str
    series: Mapping[str, tuple[str, ...]]
    steps: Mapping[str, float]
    main: str
    main_is_full: bool


class SparseSource(FileSource):
    """A table whose series were joined: the rows of the most frequent one, the others read at their times."""

    def __init__(self, source: FileSource, pattern: _SeriesPattern) -> None:
        self._source, self._pattern = source, pattern
        self._places = {
            column: name for name, columns in pattern.series.items() if name != pattern.main for column in columns
        }
        super().__init__(source.names, source.units)
        self.sample_rows = source.sample_rows
        others = [_name_columns(columns) for name, columns in pattern.series.items() if name != pattern.main]
        self.inner = source
        self.own_remarks = (describe_join(_name_columns(pattern.series[pattern.main]), others),)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        pattern = self._pattern
        own = [name for name in columns if name not in self._places and name != pattern.time]
        by_series: dict[str, list[str]] = {pattern.main: own}
        for name in columns:
            if name in self._places:
                by_series.setdefault(self._places[name], []).append(name)
        probe = pattern.series[pattern.main][0]
        needed = list(
            dict.fromkeys([pattern.time, probe, *(column for names in by_series.values() for column in names)])
        )
        size = min(_BLOCK_SAMPLES, choose_block_rows(len(columns)))
        join, latest, first_row = self._make_join(by_series, size), -np.inf, 0
        for batch in self._source.batches(needed):
            values = {name: to_float_column(batch, name, first_row) for name in needed}
            t = values[pattern.time]
            lost = np.flatnonzero(~np.isfinite(t))
            if len(lost):
                row = first_row + int(lost[0]) + 1
                raise RecordingError(
                    f"Column {pattern.time} has no number in row {row}; every row needs a time, because the signals "
                    "are joined by time.",
                    pointer=pattern.time,
                    title="Time is not a number",
                    row=row,
                )
            back = _RUN * pattern.steps[pattern.main]
            # Where the time goes back another run begins, and nothing is joined across: what waits is given first.
            for part in _split_runs(t, back):
                if len(t[part]) and t[part][0] < latest - back:
                    yield from self._make_batch(join.rows(last=True), by_series, columns)
                    join = self._make_join(by_series, size)
                self._add_samples(join, by_series, {name: column[part] for name, column in values.items()}, probe)
                latest = float(t[part][-1]) if len(t[part]) else latest
                if join.is_full:
                    yield from self._make_batch(join.rows(), by_series, columns)
            first_row += batch.num_rows
        yield from self._make_batch(join.rows(last=True), by_series, columns)

    def _make_join(self, by_series: Mapping[str, list[str]], size: int) -> TimeJoin:
        steps = self._pattern.steps
        return TimeJoin(
            {name: SampleSeries(own, steps[name]) for name, own in by_series.items()}, self._pattern.main, size
        )

    def _add_samples(
        self, join: TimeJoin, by_series: Mapping[str, list[str]], values: Mapping[str, FloatArray], probe: str
    ) -> None:
        t = values[self._pattern.time]
        for name, own in by_series.items():
            table = np.column_stack([values[column] for column in own]) if own else np.empty((len(t), 0))
            if name == self._pattern.main:
                # Of the main series a row counts if its first column has a number; of others, if any of them has.
                has_sample = np.isfinite(values[probe]) | self._pattern.main_is_full
            else:
                has_sample = np.asarray(np.isfinite(table).any(axis=1))
            join.add(name, t[has_sample], own, table[has_sample])

    def _make_batch(
        self, joined: JoinedSamples, by_series: Mapping[str, list[str]], columns: list[str]
    ) -> Iterator[pa.RecordBatch]:
        if not len(joined.times):
            return
        values = {self._pattern.time: joined.times}
        for name, own in by_series.items():
            values |= {column: joined.values[name][:, place] for place, column in enumerate(own)}
        yield batch_from_arrays(values, columns)


def join_sparse_rows(source: FileSource) -> FileSource:
    """Return the file with its series joined, if they have rows of their own.

    Parameters
    ----------
    source : FileSource
        The file as it is.

    Returns
    -------
    FileSource
        The same object if nothing is to be joined.
    """
    if not source.has_gaps:
        return source
    pattern = _find_pattern(source)
    return source if pattern is None else SparseSource(source, pattern)


class OwnClocksSource(FileSource):
    """A table whose columns have times of their own: read at those of the most frequent one.

    Parameters
    ----------
    source : FileSource
        The table as it is.
    series : mapping of str to sequence of str
        Columns that share a time, by the first of their columns of time.
    steps : mapping of str to float
        Usual step of each time in s, as far as the file states units.
    """

    def __init__(self, source: FileSource, series: Mapping[str, Sequence[str]], steps: Mapping[str, float]) -> None:
        self._source, self._series = source, series
        self._main = min(series, key=lambda time: steps[time])
        timed = {name for names in series.values() for name in names}
        names = [name for name in source.names if name in timed]
        super().__init__([_TIME, *names], {name: unit for name, unit in source.units.items() if name in timed})
        unit, scale = read_time_unit(self._main, source.units.get(self._main))
        if unit:
            self.units[_TIME] = unit
        self._scales = {time: read_time_unit(time, source.units.get(time))[1] / scale for time in series}
        self._steps = {time: steps[time] / scale for time in series}
        self.sample_rows, self.texts, self.inner = source.sample_rows, source.texts, source
        # Empty cells below the shorter columns are filled as the series are joined.
        self.has_gaps = source.has_gaps and len(series) == 1
        if len(series) > 1:
            self.own_remarks = ("Columns have times of their own: they are interpolated at the times of the fastest.",)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        stored = [self._main if name == _TIME else name for name in columns]
        if len(self._series) == 1:
            for batch in self._source.batches(list(dict.fromkeys(stored))):
                yield pa.RecordBatch.from_arrays([batch.column(name) for name in stored], names=columns)
            return
        own = {time: [name for name in columns if name in members] for time, members in self._series.items()}
        own = {time: names for time, names in own.items() if names or time == self._main}
        size = min(_BLOCK_SAMPLES, choose_block_rows(len(columns)))
        join = TimeJoin({time: SampleSeries(names, self._steps[time]) for time, names in own.items()}, self._main, size)
        first_row = 0
        for batch in self._source.batches([*own, *(name for names in own.values() for name in names)]):
            for time, names in own.items():
                t = self._scales[time] * to_float_column(batch, time, first_row)
                table = [to_float_column(batch, name, first_row) for name in names]
                has_time = np.isfinite(t)
                values = np.column_stack(table) if table else np.empty((len(t), 0))
                join.add(time, t[has_time], names, values[has_time])
            first_row += batch.num_rows
            if join.is_full:
                yield from self._make_batch(join.rows(), own, columns)
        yield from self._make_batch(join.rows(last=True), own, columns)

    def _make_batch(
        self, joined: JoinedSamples, own: Mapping[str, Sequence[str]], columns: list[str]
    ) -> Iterator[pa.RecordBatch]:
        if len(joined.times):
            values = {_TIME: joined.times}
            for time, names in own.items():
                values |= {name: joined.values[time][:, place] for place, name in enumerate(names)}
            yield batch_from_arrays(values, columns)


_TIME = "time"
"""What the time is called that all columns get."""


def join_own_clocks(source: FileSource) -> FileSource:
    """Return the file with one time for all columns, if they have times of their own; else the same object."""
    clocks = source.clocks or _find_clocks_of_blocks(source)
    first = next(iter(source.batches(list(dict.fromkeys(clocks.values())))), None) if clocks else None
    if first is None:
        return source
    series: dict[bytes, list[str]] = {}
    times: dict[bytes, str] = {}
    for name, clock in clocks.items():
        stamps = to_float_column(first, clock, 0).tobytes()
        # Channels of one sampling time have the same stamps.
        series.setdefault(stamps, []).append(name)
        times.setdefault(stamps, clock)
    steps, spans = {}, {}
    for clock in times.values():
        t = read_time_unit(clock, source.units.get(clock))[1] * to_float_column(first, clock, 0)
        step = np.diff(t)
        step = step[np.isfinite(step) & (step > 0)]
        steps[clock] = float(np.median(step)) if len(step) else np.inf
        spans[clock] = (float(np.nanmin(t)), float(np.nanmax(t))) if np.isfinite(t).any() else (np.inf, -np.inf)
    main = min(steps, key=lambda clock: steps[clock])
    by_clock = {times[stamps]: names for stamps, names in series.items()}
    (first_time, last_time), of_main = spans[main], _name_columns(by_clock[main])
    foreign = [clock for clock, span in spans.items() if not (span[0] <= last_time and first_time <= span[1])]
    remarks = tuple(
        describe_foreign_clock(_name_columns(by_clock.pop(clock)), spans[clock], of_main, spans[main])
        for clock in foreign
    )
    joined = OwnClocksSource(source, by_clock, steps)
    joined.own_remarks += remarks
    return joined


_TIME_WORDS = frozenset({"t", "time", "timestamp", "stamp", "zeit", "temps", "tiempo", "tempo"})
_FEWER_ROWS = 0.9
"""Share of the longest block's rows that a shorter one has at most: rows that are lost at an end make none."""
_LONGEST_BESIDE = 2.0
"""Ratio of the times that two blocks of one recording take, at most."""


def _find_clocks_of_blocks(source: FileSource) -> dict[str, str]:
    """Return the time of each column where blocks of other numbers of rows stand side by side, each behind its time.

    In rows of one number a second time says when something else happened, in whatever unit it counts.
    """
    named = [name for name in source.names if _TIME_WORDS & set(re.split("[^a-z]+", name.casefold()))]
    first = next(iter(source.batches(named)), None) if len(named) > 1 and named[0] == source.names[0] else None
    steps = {}
    for name in named if first is not None else ():
        t = to_float_column(first, name, 0)
        step = np.diff(t[: np.isfinite(t).sum()])
        if len(step) >= _FEWEST and (step > 0.0).all():
            steps[name] = read_time_unit(name, source.units.get(name))[1] * float(np.median(step))
    if source.names[0] not in steps or len(steps) < 2:
        return {}
    counts = _count_rows(source, list(steps))
    seconds = {name: counts[name] * step for name, step in steps.items()}
    whole, clock_of, clock = seconds[source.names[0]], dict[str, str](), ""
    for name in source.names:
        if whole <= _LONGEST_BESIDE * seconds.get(name, 0.0) <= _LONGEST_BESIDE**2 * whole:
            clock = name
        else:
            clock_of[name] = clock
    lengths = [counts[clock] for clock in clock_of.values()]
    if not lengths or min(lengths) > _FEWER_ROWS * max(lengths):
        return {}
    ends = _count_rows(source, list(clock_of))
    return clock_of if all(ends[name] <= counts[clock] for name, clock in clock_of.items()) else {}


def _count_rows(source: FileSource, names: list[str]) -> dict[str, int]:
    """Return the rows down to the last number of each column."""
    counts, first_row = dict.fromkeys(names, 0), 0
    for batch in source.batches(names):
        for name in names:
            filled = np.flatnonzero(np.isfinite(to_float_column(batch, name, first_row)))
            counts[name] = first_row + int(filled[-1]) + 1 if len(filled) else counts[name]
        first_row += batch.num_rows
    return counts


def describe_join(main: str, others: Sequence[str]) -> str:
    """Say which signal's rows are used, and that the others are read at its times."""
    shown = others if len(others) <= _SHOWN else [*others[: _SHOWN - 1], "…", others[-1]]
    return (
        f"Signals are on different rows: the rows of {main} are used, and {', '.join(shown)} are read at those times, "
        "on a straight line between two samples where they have none."
    )


_SHOWN = 4


def _name_columns(columns: Sequence[str]) -> str:
    return columns[0] if len(columns) == 1 else f"{columns[0]} … {columns[-1]}"


def _split_runs(t: FloatArray, back: float) -> list[slice]:
    """Return slices of rows between which the time goes back by more than `back`."""
    begins = np.flatnonzero(np.diff(t) < -back) + 1
    return [slice(first, last) for first, last in pairwise([0, *begins.tolist(), len(t)])]


def _find_pattern(source: FileSource) -> _SeriesPattern | None:
    """Return which columns have their rows together, from the first rows; None if all have all rows."""
    blocks, rows = [], 0
    for block in source.blocks():
        blocks.append(block[: _LOOKED_AT - rows])
        rows += len(blocks[-1])
        if rows >= _LOOKED_AT:
            break
    if rows < 2 * _FEWEST:
        return None
    values = np.concatenate(blocks)
    has_value = np.isfinite(values)
    # Time and row counters never go back and are never empty.
    running = has_value.all(axis=0) & (np.diff(values, axis=0) >= 0).all(axis=0) & (np.ptp(values, axis=0) > 0)
    time = _find_time_column(source.names, values, running)
    if time is None:
        return None
    t = values[:, time]
    # Every message has a time: its parts are no signal, though the smaller ones go back.
    for stamp in find_stamp_pairs([name for name in source.names if not name.endswith("time")]).values():
        running[[source.names.index(part) for part in stamp[:2]]] = True
    patterns: dict[bytes, list[int]] = {}
    for column in np.flatnonzero(~running & (has_value.sum(axis=0) >= _FEWEST)).tolist():
        # Columns that are filled in the same rows are one series.
        patterns.setdefault(np.packbits(has_value[:, column]).tobytes(), []).append(column)
    groups = sorted(patterns.values(), key=lambda columns: -has_value[:, columns[0]].sum())
    if not any(_alternates(has_value[:, columns[0]]) for columns in groups):
        return None
    main, *others = groups
    # What is filled in the other rows alone comes in messages of its own, such as those of a gripper.
    are_apart = any(not (has_value[:, group[0]] & has_value[:, main[0]]).any() for group in others)
    is_full = bool(has_value[:, main[0]].mean() >= _FULL) and not are_apart
    if is_full:
        # Signals that are only short of some samples stay in their rows, and so do those that are held.
        others = [
            group
            for group in others
            if _alternates(has_value[:, group[0]]) and has_value[:, group[0]].mean() >= _SLOWEST
        ]
    if not others:
        return None
    series = {source.names[group[0]]: tuple(source.names[column] for column in group) for group in (main, *others)}
    steps = {source.names[group[0]]: float(np.median(np.diff(t[has_value[:, group[0]]]))) for group in (main, *others)}
    return _SeriesPattern(source.names[time], series, steps, source.names[main[0]], is_full)


def _alternates(has_value: BoolArray) -> bool:
    """Return whether a signal has only part of the rows, and these lie between the others, not in one block."""
    present, absent = int(has_value.sum()), int((~has_value).sum())
    begins = int((np.diff(has_value.astype(np.int8)) == 1).sum())
    return present < _FULL * len(has_value) and begins >= 0.5 * min(present, absent)


def _find_time_column(names: Sequence[str], values: FloatArray, running: BoolArray) -> int | None:
    """Return the column of the time that rows are joined on: one that never goes back, and no row counter."""
    columns = np.flatnonzero(running).tolist()
    called = [column for column in columns if is_time_name(names[column])]
    even = [column for column in columns if not (np.diff(values[:, column]) == 1.0).all()]
    return next(iter((*called, *even)), None)


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
        """Return the rows up to the time that every series has reached, or the `last` ones too, and forget them."""
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
