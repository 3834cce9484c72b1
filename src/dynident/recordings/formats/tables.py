"""Tables: CSV in its dialects, and Parquet."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from dynident.recordings.arrow import streamed_parquet
from dynident.recordings.dialects import Dialect, csv_dialect
from dynident.recordings.lists import list_columns, places_of, spread, spread_names, stored_name
from dynident.recordings.raw import BATCH_ROWS, FileSource
from dynident.recordings.types import RecordingError

CSV_BLOCK_BYTES = 1 << 19
"""Arrow reads up to 32 such blocks ahead; smaller ones are as fast, and 4 MiB took 150 MB."""

_NULLS = ["", "nan", "NaN", "NAN", "-nan", "NA", "N/A", "null", "NULL", "None", "inf", "-inf", "Inf", "-Inf"]


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
