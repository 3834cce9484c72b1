"""The interface of all readers: a file as named columns in blocks of rows (`FileSource`), and a sample of its rows.

Holds how many rows a sample has (262,144), marks for missing numbers such as -9999, and names for columns without one.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
import pyarrow as pa

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.errors import Remedy
from dynident.recordings.arrow_tables import from_numbers, parse_numbers, to_floats
from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.file_size_limits import TITLE, check_columns
from dynident.recordings.recording import are_readings
from dynident.recordings.recording_metadata import RecordingError

MAX_ROWS = 1 << 18
INTERVALS = 16


@dataclass(frozen=True, eq=False)
class RawSample:
    """Raw rows in SI units from evenly spread intervals of a file.

    Parameters
    ----------
    row : (m,) of int
        Data rows of the file, counted from 1.
    t : (m,)
        Times in s.
    q, tau : (m, n)
        Positions in rad or m, and torques in N m or forces in N.
    dq : (m, n) or None
        Velocities in rad/s or m/s; None where the file gives none.
    joined : (m,) of bool
        True where a row directly follows the row before it in the file.
    used : (m,) of bool
        True inside the windows.
    """

    row: IntArray
    t: FloatArray
    q: FloatArray
    tau: FloatArray
    dq: FloatArray | None
    joined: BoolArray
    used: BoolArray


class SampleCollector:
    """Keeps all rows of a short recording, and evenly spread parts of a long one."""

    def __init__(self, n_rows: int, n: int, kinds: tuple[str, ...]) -> None:
        self._n = n
        self._dq = kinds.index("dq") * n if "dq" in kinds else None
        complete = n_rows <= MAX_ROWS
        length = n_rows if complete else MAX_ROWS // INTERVALS
        count = 1 if complete else INTERVALS
        starts = np.linspace(0, n_rows - length, count).astype(np.int64)
        self._intervals = [(int(start), int(start) + length) for start in starts]
        self._parts: list[tuple[IntArray, RawRows, BoolArray]] = []

    def feed(self, rows: RawRows, used: BoolArray) -> None:
        """Take the next rows and whether they lie in a window."""
        end = rows.first_row + len(rows.t)
        for start, stop in self._intervals:
            first, last = max(start, rows.first_row), min(stop, end)
            if first < last:
                part = slice(first - rows.first_row, last - rows.first_row)
                # Copies: a part of a block would keep all of it.
                rows_of_part = RawRows(first, rows.t[part].copy(), rows.segment[part].copy(), rows.values[part].copy())
                self._parts.append((np.arange(first + 1, last + 1), rows_of_part, used[part]))

    def result(self) -> RawSample:
        """Return the sample; rows without numbers are left out."""
        if not self._parts:
            nothing = np.empty((0, self._n))
            marks = np.empty(0, dtype=bool)
            return RawSample(np.empty(0, dtype=np.int64), np.empty(0), nothing, nothing, None, marks, marks)
        row = np.concatenate([numbers for numbers, _, _ in self._parts])
        t = np.concatenate([rows.t for _, rows, _ in self._parts])
        label = np.concatenate([rows.segment for _, rows, _ in self._parts])
        values = np.concatenate([rows.values for _, rows, _ in self._parts])
        used = np.concatenate([mark for _, _, mark in self._parts])
        joined = np.zeros(len(t), dtype=bool)
        joined[1:] = (np.diff(row) == 1) & (np.diff(label) == 0) & (np.diff(t) > 0)
        # Positions and torques come first among the columns; others may be missing.
        whole = np.all(are_readings(values[:, : 2 * self._n]), axis=1)
        joined[1:] &= whole[:-1]
        n = self._n
        dq = None if self._dq is None else values[whole, self._dq : self._dq + n]
        return RawSample(
            row[whole],
            t[whole],
            values[whole, :n],
            values[whole, n : 2 * n],
            dq,
            joined[whole],
            used[whole],
        )


class RawRows(NamedTuple):
    """Rows of the file in SI: first_row counts data rows from 0; t (m,), segment (m,), values (m, c) by kinds."""

    first_row: int
    t: FloatArray
    segment: IntArray
    values: FloatArray


class RawSource(Protocol):
    """A file, or arrays, that can be read from the beginning as often as needed."""

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Yield t and segment alone; values are empty."""
        ...

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Yield everything that the layout names."""
        ...


class Repair(str):
    """A remark on numbers that were changed, which is a warning; other remarks say how a file is laid out."""

    __slots__ = ()


class FileSource:
    """A user's file with named columns.

    Parameters
    ----------
    names : sequence of str
        Of the columns.
    units : mapping, optional
        Units that the file states, by column.
    """

    sample_rows = 1 << 16
    """First rows that are enough of a sample to tell the columns, and are read in a moment."""
    texts: Mapping[str, Sequence[str]] = MappingProxyType({})
    """The first cells of columns that hold words, by their names."""
    has_gaps = False
    """Whether cells of the first rows are empty."""
    own_remarks: tuple[str, ...] = ()
    """What this object does to read the file, where that is not plain."""
    inner: FileSource | None = None
    """The source that this one reads from."""
    clocks: Mapping[str, str] = MappingProxyType({})
    """Columns with a time of their own: of their names to the column of that time."""
    stated_rate: float | None = None
    """Hz of the rows by what the file says beside its columns, such as a sampling time."""

    def __init__(self, names: Sequence[str], units: Mapping[str, str] | None = None) -> None:
        check_columns(len(names))
        for name in names:
            _check_name(name)
        self.names = list(names)
        self.units = dict(units or {})

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was done to read the file, where that is not plain; complete after its rows were read."""
        return (*(() if self.inner is None else self.inner.remarks), *self.own_remarks)

    def blocks(self) -> Iterator[FloatArray]:
        """Yield all columns as they are, (m, columns) at a time; what is no number is NaN."""
        first = 0
        for batch in self._batches(self.names):
            yield np.column_stack([to_float_column(batch, name, first) for name in self.names])
            first += batch.num_rows

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Yield t and segment alone; values are empty."""
        yield from self._read(layout, ())

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Yield everything that the layout names."""
        yield from self._read(layout, tuple(column.source for column in layout.columns))

    def _read(self, layout: Layout, columns: tuple[str, ...]) -> Iterator[RawRows]:
        sources = [layout.t.source, *([layout.segment.source] if layout.segment else []), *columns]
        first = 0
        # A column may serve two signals, and is read once.
        for batch in self._batches(list(dict.fromkeys(sources))):
            t = layout.t.convert(to_float_column(batch, layout.t.source, first))
            segment = np.zeros(len(t), dtype=np.int64)
            if layout.segment is not None:
                segment = _to_whole_numbers(
                    to_float_column(batch, layout.segment.source, first), layout.segment.source, first
                )
            values = np.empty((len(t), len(columns)))
            for index, column in enumerate(layout.columns if columns else ()):
                values[:, index] = column.convert(to_float_column(batch, column.source, first))
            if columns and not layout.has_own_torque_columns:
                layout.make_torques(values)
            yield RawRows(first, t, segment, values)
            first += len(t)

    def batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield some columns as they are stored."""
        return self._batches(columns)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        raise NotImplementedError


def _check_name(name: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError as error:
        detail = f"The column name {name!a} is not valid Unicode text; rename the column."
        raise RecordingError(detail, title=TITLE) from error


def to_float_column(batch: pa.RecordBatch, name: str, first_row: int) -> FloatArray:
    """Return a column as float64.

    Parameters
    ----------
    batch : pyarrow.RecordBatch
        Rows of the file.
    name : str
        Name of the column.
    first_row : int
        Data row of the file, from 0, with which the batch begins; for the message of an error.

    Returns
    -------
    (m,)
        Nulls are NaN, instants in time and durations are seconds.

    Raises
    ------
    RecordingError
        For a column of another kind.
    """
    column = batch.column(batch.schema.get_field_index(name))
    kind = column.type
    try:
        if pa.types.is_timestamp(kind):
            # Time stamps of any resolution, by way of nanoseconds since 1970.
            column = column.cast(pa.timestamp("ns")).cast(pa.int64())
            return to_floats(column.cast(pa.float64(), safe=False)) * 1e-9
        if pa.types.is_duration(kind):
            column = column.cast(pa.duration("ns"), safe=False).cast(pa.int64())
            return to_floats(column.cast(pa.float64(), safe=False)) * 1e-9
        if pa.types.is_dictionary(kind):
            column, kind = column.dictionary_decode(), kind.value_type
        if pa.types.is_string(kind) or pa.types.is_large_string(kind):
            # Words beside the signals, or in the place of single values.
            column = parse_numbers(column)
        elif pa.types.is_boolean(kind):
            column = column.cast(pa.uint8()).cast(pa.float64())
        elif not pa.types.is_float64(kind):
            column = column.cast(pa.float64(), safe=False)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise RecordingError(
            f"Column {name} contains {kind}, not numbers (rows {first_row + 1} to {first_row + batch.num_rows}): "
            f"{error}",
            pointer=name,
            title="Not a number",
        ) from error
    return to_floats(column)


def _to_whole_numbers(values: FloatArray, name: str, first_row: int) -> IntArray:
    bad = np.flatnonzero(~(np.isfinite(values) & (values == np.rint(values))))
    if len(bad):
        row = first_row + int(bad[0])
        raise RecordingError(
            f"Column {name} is {values[bad[0]]} in row {row + 1}; a segment must be a whole number.",
            pointer=name,
            row=row + 1,
        )
    return values.astype(np.int64)


@contextmanager
def quote_remarks(remarks: Sequence[str]) -> Iterator[None]:
    """Say in errors how a file was read: its columns and rows may not be those that the user sees in it.

    Parameters
    ----------
    remarks : sequence of str
        Those of the file.
    """
    try:
        yield
    except RecordingError as error:
        if not remarks:
            raise
        raise RecordingError(
            f"{error.detail} (How the file was read: {' '.join(remarks)})",
            pointer=error.pointer,
            title=error.title,
            row=error.row,
            time=error.time,
            checks=error.checks,
            remedies=error.remedies,
        ) from error


FEWEST_BURSTS, LONGEST_BURST = 3, 200
"""Whole bursts by which they are known, and rows of the longest: a receiver's buffer holds no more."""

UNEVEN_ROWS, UNEVEN_TIMES = 0.25, 0.5
"""Shares of the usual one by which the rows of a burst, and the time from one to the next, may differ."""

MOST_OF_STEP = 0.5
"""Usual time between rows, over that of rows spread evenly, up to which they come in bursts."""


def find_bursts(last_rows: IntArray, times: FloatArray, step: float) -> tuple[int, float]:
    """Return how many rows come at a time where a buffer is read now and then, and the rate that they were sampled at.

    Parameters
    ----------
    last_rows : (k,) of int
        The last rows before gaps.
    times : (k,)
        Their times.
    step : float
        The usual time from row to row.

    Returns
    -------
    tuple of int and float
        Rows of a burst, and rows per unit of time of whole bursts; 0 where gaps are irregular, as those of lost rows.
        Bursts may have different lengths, where each gap is as much longer as the burst behind it has more rows.
    """
    if len(last_rows) <= FEWEST_BURSTS:
        return 0, 0.0
    rows, spans = np.diff(last_rows), np.diff(times)
    burst, span = float(np.median(rows)), float(np.median(spans))
    is_even = np.ptp(rows) <= UNEVEN_ROWS * burst and np.abs(spans - span).max() <= UNEVEN_TIMES * span
    rate = float((last_rows[-1] - last_rows[0]) / (times[-1] - times[0]))
    # A burst that a network delayed waited for as long as its rows took, so its gap is compared: the whole span grows
    # with the rows of any recording whose gaps are short.
    gap = float(np.median(spans - (rows - 1) * step))
    is_delayed = np.quantile(np.abs(spans - rows / rate), 0.9) <= UNEVEN_ROWS * gap and np.ptp(rows) > 1
    # Rows of a burst come much closer together than they were sampled; else they have times of their own.
    has_times = step * rate > MOST_OF_STEP
    if burst > LONGEST_BURST or has_times or not (is_even or is_delayed):
        return 0, 0.0
    return round(burst), rate


def describe_bursts(name: str, burst: int, rate: float) -> tuple[str, Remedy]:
    """Say of which kind rows are that come several at a time, and state their rate.

    Parameters
    ----------
    name : str
        Name of the time.
    burst : int
        Rows of a burst.
    rate : float
        Rows in a second.
    """
    remedy = Remedy("rate", float(f"{rate:.4g}"))
    detail = (
        f"The rows come {burst} at a time by {name}, as where a network delays them or a buffer is read: it then says "
        f"when they arrived, not when they were measured. If they were sampled evenly, state their rate: {remedy}."
    )
    return detail, remedy


_NINES = tuple(sign * (10.0**digits - 1.0) for digits in range(3, 10) for sign in (-1.0, 1.0))
_HUGE = 1e30
_FEWEST_MARKS, _FAR = 3, 5.0
"""Cells that hold a mark, and how many times larger it is than every other number of its column."""


class MarkedGapsSource(FileSource):
    """A file in which a number that no sensor gives, such as -9999, stands for a missing one."""

    def __init__(self, source: FileSource, marks: Mapping[str, float]) -> None:
        super().__init__(source.names, source.units)
        self._source, self._marks = source, marks
        self.sample_rows, self.texts, self.has_gaps = source.sample_rows, source.texts, source.has_gaps
        self.inner, self.clocks = source, source.clocks
        numbers, names = sorted(set(marks.values())), list(marks)
        self.own_remarks = (
            f"{' or '.join(f'{number:g}' for number in numbers)} stands for a missing number, in "
            f"{', '.join(names[:_SHOWN_NAMES])}{', …' if len(names) > _SHOWN_NAMES else ''}.",
        )

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        first_row = 0
        for batch in self._source.batches(columns):
            arrays = []
            for name in columns:
                column = batch.column(batch.schema.get_field_index(name))
                if name in self._marks:
                    values = to_float_column(batch, name, first_row)
                    column = from_numbers(np.where(values == self._marks[name], np.nan, values))
                arrays.append(column)
            yield pa.RecordBatch.from_arrays(arrays, names=columns)
            first_row += batch.num_rows


_SHOWN_NAMES = 4


def read_marked_gaps(source: FileSource) -> FileSource:
    """Return the file with missing numbers where its first rows have marks for them; else the same object."""
    names = [name for name in source.names if name not in source.texts]
    first = next(source.batches(names), None) if names else None
    if first is None:
        return source
    possible: list[tuple[str, float, int]] = []
    for name in names:
        values = to_float_column(first, name, 0)
        values = values[np.isfinite(values)]
        for mark in {float(values.min()), float(values.max())} if len(values) else ():
            if mark not in _NINES and abs(mark) < _HUGE:
                continue
            others = np.abs(values[values != mark])
            if others.max(initial=0.0) * _FAR < abs(mark):
                possible.append((name, mark, len(values) - len(others)))
    # A column may have few of them, or one: all columns together tell a mark.
    counts = {mark: sum(count for _, other, count in possible if other == mark) for _, mark, _ in possible}
    marks = {name: mark for name, mark, _ in possible if counts[mark] >= _FEWEST_MARKS}
    return MarkedGapsSource(source, marks) if marks else source


_COUNTED = re.compile(r"(.*?)(\d{1,3})(\D*)")


def fill_blank_names(names: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names for columns that have none: the one that a count of the names around it leaves out, or a number.

    Parameters
    ----------
    names : tuple of str
        The names, "" where there is none; a single one may be that of the rows.

    Returns
    -------
    names : tuple of str
        The names.
    remarks : tuple of str
        Which name was taken for one.
    """
    result, remarks = list(names), []
    for place in range(1, len(names) - 1):
        around = [_COUNTED.fullmatch(names[place + side]) for side in (-1, 1)]
        if names[place] or around[0] is None or around[1] is None:
            continue
        (before, low, behind), (*other, high) = around[0].groups(), around[1].group(1, 3, 2)
        name = f"{before}{int(low) + 1:0{len(low)}d}{behind}"
        if [before, behind] == other and int(high) == int(low) + 2 and name not in names:
            result[place] = name
            remarks.append(
                f"Column {place + 1} has no name; between {names[place - 1]} and {names[place + 1]} it is {name}."
            )
    if result.count("") > 1:
        result = [name or f"column{place + 1}" for place, name in enumerate(result)]
    return tuple(result), tuple(remarks)
