"""Reading the user's file as it is: CSV in its dialects, or Parquet, in blocks of rows."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from dynident.arrays import FloatArray, IntArray
from dynident.recordings.arrow import streamed_parquet, to_floats
from dynident.recordings.columns import Layout
from dynident.recordings.dialects import Dialect, csv_dialect
from dynident.recordings.lists import list_columns, places_of, spread, spread_names, stored_name
from dynident.recordings.types import RecordingError

BATCH_ROWS = 32768
CSV_BLOCK_BYTES = 1 << 19
"""Arrow reads up to 32 such blocks ahead; smaller ones are as fast, and 4 MiB took 150 MB."""

_WRITTEN = {"csv": "CSV", "parquet": "Parquet"}
_NULLS = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "null", "NULL", "None", "inf", "-inf", "Inf", "-Inf"]


class RawRows(NamedTuple):
    """Rows of the file in SI: first_row counts data rows from 0; t (m,), segment (m,), values (m, c) by kinds."""

    first_row: int
    t: FloatArray
    segment: IntArray
    values: FloatArray


class RawSource(Protocol):
    """A file, or arrays, that can be read from the beginning as often as needed."""

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Give t and segment alone; values are empty."""
        ...

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Give everything that the layout names."""
        ...


class FileSource:
    """A file of the user's with named columns; `units` are those that the file states, by its columns."""

    sample_rows = 1 << 16
    """First rows that are enough of a sample to tell the columns, and are read in a moment."""

    def __init__(self, names: Sequence[str], units: Mapping[str, str] | None = None) -> None:
        self.names = list(names)
        self.units = dict(units or {})

    def blocks(self) -> Iterator[FloatArray]:
        """Give all columns as they are, (m, columns) at a time; what is no number is NaN."""
        first = 0
        for batch in self._batches(self.names):
            yield np.column_stack([_floats(batch, name, first) for name in self.names])
            first += batch.num_rows

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Give t and segment alone; values are empty."""
        yield from self._read(layout, ())

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Give everything that the layout names."""
        yield from self._read(layout, tuple(column.source for column in layout.columns))

    def _read(self, layout: Layout, columns: tuple[str, ...]) -> Iterator[RawRows]:
        wanted = [layout.t.source, *([layout.segment.source] if layout.segment else []), *columns]
        first = 0
        for batch in self._batches(list(dict.fromkeys(wanted))):
            t = layout.t.convert(_floats(batch, layout.t.source, first))
            segment = np.zeros(len(t), dtype=np.int64)
            if layout.segment is not None:
                segment = _whole(_floats(batch, layout.segment.source, first), layout.segment.source, first)
            values = np.empty((len(t), len(columns)))
            for index, column in enumerate(layout.columns if columns else ()):
                values[:, index] = column.convert(_floats(batch, column.source, first))
            if columns and layout.mixing is not None:
                values[:, layout.place("tau")] = values[:, layout.place("tau")] @ layout.mixing
            yield RawRows(first, t, segment, values)
            first += len(t)

    def batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        """Give some columns as they are stored."""
        return self._batches(columns)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        raise NotImplementedError


class ParquetFileSource(FileSource):
    """A Parquet file of the user's."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            schema = pq.read_schema(path)
            self._lists = places_of(path, list_columns(path, schema))
            super().__init__(spread_names(schema, self._lists))
        except (pa.ArrowInvalid, pa.ArrowIOError) as error:
            raise RecordingError(f"The file cannot be read as Parquet: {error}", title="Unreadable file") from error

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        try:
            with streamed_parquet(self._path) as file:
                stored = list(dict.fromkeys(stored_name(name, self._lists) for name in columns))
                for batch in file.iter_batches(BATCH_ROWS, columns=stored, use_threads=False):
                    yield spread(batch, columns, self._lists) if self._lists else batch
        except (pa.ArrowInvalid, pa.ArrowIOError) as error:
            raise RecordingError(f"The file cannot be read as Parquet: {error}", title="Unreadable file") from error


class CsvFileSource(FileSource):
    """A CSV file of the user's: comma, semicolon, tab or bar between columns; point or comma in numbers."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._dialect = csv_dialect(path)
        super().__init__(self._dialect.names, self._dialect.units)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        dialect = self._dialect
        try:
            with pacsv.open_csv(
                self._path,
                read_options=pacsv.ReadOptions(
                    column_names=list(dialect.names),
                    skip_rows=dialect.lines_before_data,
                    block_size=CSV_BLOCK_BYTES,
                    use_threads=False,
                ),
                parse_options=pacsv.ParseOptions(delimiter=dialect.delimiter),
                convert_options=pacsv.ConvertOptions(
                    include_columns=columns,
                    column_types={name: pa.float64() for name in columns},
                    null_values=_NULLS,
                    decimal_point=dialect.decimal_point,
                ),
            ) as reader:
                yield from reader
        except pa.ArrowInvalid as error:
            raise _csv_error(str(error), dialect) from error


def open_source(path: Path, file_format: str | None) -> FileSource:
    """Open a user's file; the format is told from its first bytes where it is not given.

    Raises
    ------
    RecordingError
        If the file is empty, or not what it is said to be.
    """
    # It builds on this module.
    from dynident.recordings.stamps import with_stamps

    return with_stamps(_open_source(path, file_format))


def _open_source(path: Path, file_format: str | None) -> FileSource:
    # They build on this module.
    from dynident.recordings.formats import format_of, open_foreign

    found = format_of(path)
    if file_format == "parquet" and found == "csv":
        return ParquetFileSource(path)  # which says what is wrong with it
    if file_format not in (None, found) and (found, file_format) != ("hdf5", "mat"):
        raise RecordingError(
            f'The file is {_WRITTEN.get(found, found)}, not {_WRITTEN.get(file_format, file_format)}; say "format": '
            f'"{found}".',
            pointer="/format",
        )
    if found == "parquet":
        return ParquetFileSource(path)
    return CsvFileSource(path) if found == "csv" else open_foreign(path, found)


def _floats(batch: pa.RecordBatch, name: str, first_row: int) -> FloatArray:
    """Give a column as float64, nulls as NaN; instants in time as seconds."""
    column = batch.column(batch.schema.get_field_index(name))
    kind = column.type
    try:
        if pa.types.is_timestamp(kind):
            column = column.cast(pa.timestamp("ns")).cast(pa.int64())
            return to_floats(column.cast(pa.float64(), safe=False)) * 1e-9
        if not pa.types.is_float64(kind):
            column = column.cast(pa.float64(), safe=False)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise RecordingError(
            f"Column {name} holds {kind}, not numbers (rows {first_row + 1} to {first_row + batch.num_rows}): {error}",
            pointer=name,
            title="Not a number",
        ) from error
    return to_floats(column)


def _whole(values: FloatArray, name: str, first_row: int) -> IntArray:
    bad = np.flatnonzero(~(np.isfinite(values) & (values == np.rint(values))))
    if len(bad):
        row = first_row + int(bad[0])
        raise RecordingError(
            f"Column {name} is {values[bad[0]]} in row {row + 1}; the segment has to be a whole number.",
            pointer=name,
            row=row + 1,
        )
    return values.astype(np.int64)


def _csv_error(message: str, dialect: Dialect) -> RecordingError:
    """Say what pyarrow found in the user's terms: the column by name, the row of data."""
    row = re.search(r"Row #(\d+)", message)
    column = re.search(r"CSV column #(\d+)", message)
    number = int(row.group(1)) - dialect.lines_before_data if row else None
    name = dialect.names[int(column.group(1))] if column else ""
    found = re.search(r"invalid value '(.*)'", message)
    where = (f" in column {name}" if name else "") + (f", row {number}" if number else "")
    if found:
        detail = f"{found.group(1)!r}{where} is not a number."
        if "," in found.group(1) and dialect.delimiter == ",":
            detail += " With decimal commas, separate the columns by semicolons."
    else:
        detail = f"The file cannot be read as CSV{where}: {message.split(': ', 1)[-1]}"
    return RecordingError(detail, pointer=name, title="Not a number" if found else "Unreadable file", row=number)
