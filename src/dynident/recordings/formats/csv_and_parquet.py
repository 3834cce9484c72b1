"""Readers of CSV (any dialect; which cells count as empty), Parquet and Feather."""

from __future__ import annotations

import io
import re
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import (
    batch_from_arrays,
    is_structure_list,
    open_parquet_stream,
    parse_numbers,
    split_structure_lists,
)
from dynident.recordings.cells_without_numbers import (
    expand_lists,
    expand_names,
    find_stored_name,
    list_columns,
    list_texts,
    name_list_places,
)
from dynident.recordings.csv_dialects import Dialect, detect_dialect, dialect_bytes, empty_repeated_names
from dynident.recordings.file_size_limits import (
    check_columns,
    check_unpacked,
    choose_block_rows,
    make_damaged_error,
)
from dynident.recordings.file_source import FileSource
from dynident.recordings.formats.text_streams import (
    CHANGES_OF_CELLS,
    RewrittenText,
    TextContent,
    find_stated_rate,
    join_thousands,
    refuse_date,
)
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.sample_series_join import SampleSeries, describe_join
from dynident.recordings.time_columns import is_time_name

CSV_BLOCK_BYTES = 1 << 19
"""Arrow reads up to 32 such blocks ahead; smaller ones are as fast, and 4 MiB took 150 MB."""

_PATIENCE = 1.0
"""s that the end of Arrow's thread is awaited; it takes some microseconds."""

_VALUE_BYTES = 8
_BROKEN_PARQUET = (pa.ArrowException, OSError, ValueError, KeyError, UnicodeError)
"""What pyarrow raises of files that are damaged."""

_GROUPED = re.compile(r"^[+-]?\d{1,3}(?:[.,]\d{3})+(?:[.,]\d*)?$")
_NULLS = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "null", "NULL", "None", "inf", "-inf", "Inf", "-Inf"]


class ParquetFileSource(FileSource):
    """A user's table as Arrow holds it: a Parquet file."""

    format_name = "Parquet"

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            schema, first, self.has_gaps = self._look()
            self._roots = {name: field.name for field in schema for name in _list_leaves(field)}
            first = _flatten_structs(pa.RecordBatch.from_pylist([], schema) if first is None else first)
            self._lists = name_list_places(path, list_columns(first))
            super().__init__(expand_names(first.schema, self._lists))
            self.texts = list_texts(expand_lists(first, self.names, self._lists))
        except _BROKEN_PARQUET as error:
            raise make_damaged_error(self.format_name, error) from error

    def _look(self) -> tuple[pa.Schema, pa.RecordBatch | None, bool]:
        """Return the columns, the first rows, and whether these have empty cells."""
        with open_parquet_stream(self._path) as file:
            _check_parquet(file.metadata, self._path.stat().st_size)
            first = next(file.iter_batches(_LOOKED_AT, use_threads=False), None)
            return file.schema_arrow, first, _has_nulls(file.metadata)

    def _read_batches(self, roots: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield whole columns of the file, a batch at a time."""
        with open_parquet_stream(self._path) as file:
            yield from file.iter_batches(choose_block_rows(len(self.names)), columns=roots, use_threads=False)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        stored = list(dict.fromkeys(find_stored_name(name, self._lists) for name in columns))
        try:
            for batch in self._read_batches(list(dict.fromkeys(self._roots[name] for name in stored))):
                flat = _flatten_structs(batch)
                yield expand_lists(flat, columns, self._lists) if self._lists else flat.select(columns)
        except _BROKEN_PARQUET as error:
            raise make_damaged_error(self.format_name, error) from error


class FeatherFileSource(ParquetFileSource):
    """A user's Feather file (version 2): batches of Arrow, as they lie in memory."""

    format_name = "Feather"

    def _look(self) -> tuple[pa.Schema, pa.RecordBatch | None, bool]:
        """Return the columns, the first rows, and whether these have empty cells."""
        with pa.memory_map(str(self._path)) as content, pa.ipc.open_file(content) as file:
            check_columns(len(file.schema))
            first = file.get_batch(0).slice(0, _LOOKED_AT) if file.num_record_batches else None
            return file.schema, first, first is not None and any(column.null_count for column in first.columns)

    def _read_batches(self, roots: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield whole columns of the file, a batch at a time."""
        size, n_bytes = self._path.stat().st_size, 0
        with pa.memory_map(str(self._path)) as content, pa.ipc.open_file(content) as file:
            for number in range(file.num_record_batches):
                batch = file.get_batch(number).select(roots)
                n_bytes += batch.nbytes
                check_unpacked(n_bytes, size)
                # Some writers put all rows into one batch.
                rows = choose_block_rows(len(self.names))
                yield from (batch.slice(first, rows) for first in range(0, batch.num_rows, rows))


def _list_leaves(field: pa.Field, prefix: str = "") -> list[str]:
    """Return the names of a column's parts, those in structures with the structure's name before them."""
    name = prefix + field.name
    whole = field.type.value_type if is_structure_list(field.type) else field.type
    if not pa.types.is_struct(whole):
        return [name]
    return [leaf for part in whole.fields for leaf in _list_leaves(part, f"{name}.")]


def _flatten_structs(batch: pa.RecordBatch) -> pa.RecordBatch:
    """Return the batch with the parts of structures as columns, joint_state.position; those of lists as lists."""
    while any(pa.types.is_struct(field.type) or is_structure_list(field.type) for field in batch.schema):
        batch = split_structure_lists(batch)
        names, arrays = list[str](), list[pa.Array]()
        for field, column in zip(batch.schema, batch.columns, strict=True):
            is_struct = pa.types.is_struct(field.type)
            names += [f"{field.name}.{part.name}" for part in field.type.fields] if is_struct else [field.name]
            arrays += column.flatten() if is_struct else [column]
        batch = pa.RecordBatch.from_arrays(arrays, names=names)
    return batch


_LOOKED_AT = 200
"""Rows by which lists and words are told."""


def _has_nulls(metadata: pq.FileMetaData) -> bool:
    """Return whether the first rows have empty cells, as far as the file's statistics say."""
    if not metadata.num_row_groups:
        return False
    group = metadata.row_group(0)
    all_statistics = (group.column(k).statistics for k in range(group.num_columns))
    return any(
        statistics is not None and statistics.has_null_count and bool(statistics.null_count)
        for statistics in all_statistics
    )


def _check_parquet(metadata: pq.FileMetaData, size: int) -> None:
    """Refuse a file that is said to hold many times its size: in bytes, or in values, which may be repeated."""
    check_columns(metadata.num_columns)
    groups = [metadata.row_group(k) for k in range(metadata.num_row_groups)]
    check_unpacked(sum(group.total_byte_size for group in groups), size)
    values = sum(group.column(k).num_values for group in groups for k in range(group.num_columns))
    check_unpacked(max(values, metadata.num_rows) * _VALUE_BYTES, size)


class CsvFileSource(FileSource):
    """A user's CSV file: comma, semicolon, tab or bar between columns; point or comma in numbers."""

    def __init__(self, content: TextContent) -> None:
        self._content = content
        self._dialect = detect_dialect(content.read_start(dialect_bytes))
        check_columns(len(self._dialect.names))
        if self._dialect.clocks:
            # Channels that a scope sampled more rarely end before the others, and their cells are missing.
            pad = partial(_pad_rows, self._dialect.delimiter, len(self._dialect.names))
            self._dialect = replace(self._dialect, rewrite=(*self._dialect.rewrite, pad), has_gaps=True)
        super().__init__(self._dialect.names, self._dialect.units)
        self.texts = dict(self._dialect.texts)
        self.has_gaps = self._dialect.has_gaps
        self.clocks = self._dialect.clocks
        self.stated_rate = find_stated_rate(content.read_start(dialect_bytes), self._dialect.lines_before_data)
        self._worded: dict[str, str] = {}
        self._changes: set[object] = set()
        self._odd_rows = _OddRows(len(self._dialect.names))
        for name, cells in self._dialect.texts.items():
            change = next(filter(None, map(self._find_thousands, cells)), None)
            if change is not None:
                self._dialect = replace(self._dialect, rewrite=(*self._dialect.rewrite, change))
            if "thousands" in self._changes and any(map(_GROUPED.match, cells)):
                # Numbers, which only looked like words.
                del self.texts[name]

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was done to read the file, where that is not plain; complete after its rows were read."""
        repeated = ("The names of the columns stand again between the rows: these lines are left out.",)
        return (
            *self.own_remarks,
            *self._dialect.remarks,
            *(repeated if "names" in self._changes else ()),
            *(
                f"{name} has cells that are no numbers, such as {cell!r}."
                for name, cell in self._worded.items()
                if cell
            ),
            *self._odd_rows.describe(self._dialect.lines_before_data),
        )

    def _open_text(self) -> str | IO[bytes]:
        """Return what pyarrow reads: the path if its lines are plain, which is fastest, else a stream."""
        dialect, plain = self._dialect, self._content.plain_path
        if dialect.rewrite or dialect.encoding != "utf-8":
            return io.BufferedReader(RewrittenText(self._content.open(), dialect.rewrite, dialect.encoding))
        return self._content.open() if plain is None else str(plain)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        # Rows given before a word was found are skipped when the file is read again.
        n_given = 0
        while True:
            try:
                n_skipped = n_given
                for batch in self._parse_batches(columns):
                    new = batch.slice(min(n_skipped, batch.num_rows))
                    n_skipped -= batch.num_rows - new.num_rows
                    if new.num_rows:
                        n_given += new.num_rows
                        yield new
                return
            except pa.ArrowInvalid as error:
                column = _find_word_column(str(error), self._dialect)
                if column is None or column in self._worded:
                    raise _make_csv_error(str(error), self._dialect) from error
                if (change := self._find_change(str(error), column)) is not None:
                    self._dialect = replace(self._dialect, rewrite=(*self._dialect.rewrite, change))
                    continue
                # Read again: words among the numbers of a column are cells without one.
                self._worded[column] = _read_cell(str(error))
                if not is_time_name(column):
                    refuse_date(column, self._worded[column])

    def _find_change(self, message: str, column: str) -> Callable[[str], str] | None:
        """Return a change of the lines with which a cell that is no number can be read, once for each kind."""
        cell = _read_cell(message)
        if cell == column and "names" not in self._changes:
            # Lines that are empty Arrow passes by: the rows above them stay the same.
            self._changes.add("names")
            return partial(empty_repeated_names, dialect=self._dialect)
        for applies, change in CHANGES_OF_CELLS:
            if change not in self._changes and applies(f'"{cell}"'):
                self._changes.add(change)
                return change
        return self._find_thousands(cell)

    def _find_thousands(self, cell: str) -> Callable[[str], str] | None:
        """Return the change that a cell with signs between thousands needs, once."""
        change = partial(join_thousands, decimal_point=self._dialect.decimal_point, delimiter=self._dialect.delimiter)
        if "thousands" in self._changes or change(f'"{cell}"') == f'"{cell}"':
            return None
        self._changes.add("thousands")
        return change

    def _parse_batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        dialect = self._dialect
        self._odd_rows.clear()
        # Arrow stops at the first cell that is no number: columns with words are read as text.
        words = self._worded | self.texts.keys()
        types = {name: pa.string() if name in words else pa.float64() for name in columns}
        text = self._open_text()
        judge = partial(self._odd_rows.judge_row)
        releases = [_watch_release(part) for part in (judge, text) if not isinstance(part, str)]
        reader = None
        try:
            with pacsv.open_csv(
                text,
                read_options=pacsv.ReadOptions(
                    column_names=list(dialect.names),
                    skip_rows=dialect.lines_before_data,
                    block_size=CSV_BLOCK_BYTES,
                    use_threads=False,
                ),
                parse_options=pacsv.ParseOptions(delimiter=dialect.delimiter, invalid_row_handler=judge),
                convert_options=pacsv.ConvertOptions(
                    include_columns=columns,
                    column_types=types,
                    null_values=_NULLS,
                    decimal_point=dialect.decimal_point,
                ),
            ) as reader:
                for batch in reader:
                    yield self._parse_word_columns(batch) if self._worded.keys() & columns else batch
        finally:
            # Arrow reads ahead in a thread, which aborts the program where it calls Python as that ends. The text ends
            # here, and the thread is awaited: until it has let go of the judge of rows, and of the text.
            if isinstance(text, io.BufferedReader) and isinstance(text.raw, RewrittenText):
                text.raw.is_ended = True
            del reader, judge, text
            for is_released in releases:
                is_released.wait(_PATIENCE)

    def _parse_word_columns(self, batch: pa.RecordBatch) -> pa.RecordBatch:
        """Return the batch with numbers in columns with words; a word is a missing value."""
        arrays = []
        for name, column in zip(batch.schema.names, batch.columns, strict=True):
            if name in self._worded:
                column = parse_numbers(column, self._dialect.decimal_point)
            arrays.append(column)
        return pa.RecordBatch.from_arrays(arrays, names=batch.schema.names)


class _OddRows:
    """Rows with another number of cells than there are columns: left out where they are few.

    Such are the last row of a recorder that was stopped, remarks between the rows, and the messages of another sender.
    """

    def __init__(self, width: int) -> None:
        self._width = width
        self.clear()

    def clear(self) -> None:
        """Forget the rows; the file is read again from its beginning."""
        self._count, self._first, self._text, self._cells = 0, 0, "", 0

    def judge_row(self, row: pacsv.InvalidRow) -> str:
        """Return whether to skip a row, or to stop with an error where most rows are such."""
        if 2 * self._count > (row.number or 0):
            return "error"
        if not self._count:
            self._first, self._text, self._cells = row.number or 0, row.text[:_SHOWN], row.actual_columns
        self._count += 1
        return "skip"

    def describe(self, lines_before: int) -> tuple[str, ...]:
        """Return what was left out, in a sentence; nothing where every row is whole."""
        if not self._count:
            return ()
        which = (
            f"1 row, {self._first - lines_before}, has {self._cells} cells instead of {self._width} and is"
            if self._count == 1
            else f"{self._count} rows have another number of cells than {self._width}, first row "
            f"{self._first - lines_before}, and are"
        )
        return (f"{which} left out: {self._text!r}.",)


_SHOWN = 60  # characters of a row


def _pad_rows(delimiter: str, width: int, text: str) -> str:
    """Return lines of a table, those of numbers with as many cells as there are columns."""
    lines = text.replace("\r\n", "\n").split("\n")
    missing = (width - 1 - line.count(delimiter) if _BEGINS_A_ROW.match(line) else 0 for line in lines)
    return "\n".join(line + delimiter * n for line, n in zip(lines, missing, strict=True))


_BEGINS_A_ROW = re.compile(r"\s*[-+.]?\d")


def _watch_release(watched: object) -> Event:
    """Return what is set once nobody holds an object any more."""
    is_released = Event()
    weakref.finalize(watched, is_released.set).atexit = False
    return is_released


def _find_word_column(message: str, dialect: Dialect) -> str | None:
    """Return the column in which pyarrow found something else than a number; None for any other error."""
    column = re.search(r"CSV column #(\d+)", message)
    if column is None or "invalid value" not in message:
        return None
    return dialect.names[int(column.group(1))]


def _read_cell(message: str) -> str:
    """Return the cell that pyarrow could not read as a number."""
    return message.partition("invalid value '")[2].rpartition("'")[0]


def _make_csv_error(message: str, dialect: Dialect) -> RecordingError:
    """Return pyarrow's error in the user's terms: the column by name, the row of data."""
    row = re.search(r"Row #(\d+)", message)
    column = re.search(r"CSV column #(\d+)", message)
    # Arrow counts the lines of the file, and users the rows of data.
    number = int(row.group(1)) - dialect.lines_before_data if row else None
    name = dialect.names[int(column.group(1))] if column else ""
    value = re.search(r"invalid value '(.*)'", message)
    where = (f" in column {name}" if name else "") + (f", row {number}" if number else "")
    if value:
        detail = f"{value.group(1)!r}{where} is not a number."
        if "," in value.group(1) and dialect.delimiter == ",":
            detail += " With decimal commas, separate the columns by semicolons."
    elif dialect.delimiter == "," and _has_twice_the_cells(message):
        detail = (
            f"Row {number} has about twice as many cells as there are columns: numbers with decimal commas stand "
            "between commas. Separate the columns by semicolons, or write decimal points."
        )
    elif (counts := _read_counts(message)) is not None:
        detail = (
            f"Row {number} and others have {counts[1]} cells, but there are {counts[0]} columns: the file has rows of "
            "several kinds, or names that are not those of its rows. Keep the rows of one kind, below names for all of "
            "their cells."
        )
    elif "file is too short" in message:
        detail = "The file has a line of names, but no rows of data below it."
    else:
        detail = f"The file cannot be read as CSV{where}: {message.split(': ', 1)[-1]}"
    return RecordingError(detail, pointer=name, title="Not a number" if value else "Unreadable file", row=number)


def _read_counts(message: str) -> tuple[int, int] | None:
    """Return how many columns Arrow expected, and how many cells a row has, where that is what it says."""
    counts = re.search(r"Expected (\d+) columns, got (\d+)", message)
    return None if counts is None else (int(counts[1]), int(counts[2]))


def _has_twice_the_cells(message: str) -> bool:
    """Return whether Arrow found nearly twice as many cells in a row as the table has columns."""
    counts = _read_counts(message)
    return counts is not None and 1.7 < counts[1] / counts[0] <= 2.0


class StackedSource(FileSource):
    """A table in which the rows of one signal stand below those of another, as a column for each signal.

    Parameters
    ----------
    source : FileSource
        The table as it is.
    time : str
        Its column of time.
    series : mapping of str to (m, 1 + columns)
        Time and values of every signal, by its name.
    columns : sequence of str
        Names of the columns of values.
    """

    def __init__(self, source: FileSource, time: str, series: Mapping[str, FloatArray], columns: Sequence[str]) -> None:
        main = max(series, key=lambda name: len(series[name]))
        self._values = {time: series[main][:, 0]}
        for name, table in series.items():
            names = [f"{column}_{name}" for column in columns]
            samples = SampleSeries(names, float(np.median(np.diff(table[:, 0]))))
            samples.add(table[:, 0], names, table[:, 1:])
            self._values |= dict(zip(names, samples.read_at(self._values[time]).T, strict=True))
        super().__init__(list(self._values), {time: source.units[time]} if time in source.units else {})
        self.sample_rows, self.inner = source.sample_rows, source
        self.own_remarks = (describe_join(main, [name for name in series if name != main]),)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        values = {name: np.ascontiguousarray(self._values[name]) for name in columns}
        size = choose_block_rows(len(columns))
        for first in range(0, len(next(iter(values.values()))), size):
            yield batch_from_arrays({name: column[first : first + size] for name, column in values.items()}, columns)
