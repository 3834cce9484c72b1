"""Conversion between Arrow tables and numpy arrays, and streamed reading of Parquet.

Arrow's own conversion takes a detour over pandas where that is installed, which costs a second and 40 MB in every
process that reads a recording.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.file_output import write_atomically
from dynident.lazy_loader import LazyModule
from dynident.text_encoding import escape_surrogates

pc = LazyModule("pyarrow.compute")
"""Arrow's functions of columns. Tables of plain numbers need none of them, and they take long to import."""

READ_BYTES = 1 << 16
_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"


def to_csv(table: pa.Table, *, header: bool = True) -> bytes:
    """Write a table as CSV (RFC 4180).

    Parameters
    ----------
    table : pyarrow.Table
        The columns to write.
    header : bool
        Whether the names of the columns come first.

    Returns
    -------
    bytes
        Names and texts are quoted where they have to be.
    """
    try:
        rows = _to_csv_rows(table, "none")
    except pa.ArrowInvalid:
        # A text has a comma, a quote or a line break in it: then all texts are quoted.
        rows = _to_csv_rows(table, "needed")
    return to_header_row(table.column_names) + rows if header else rows


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as CSV, or as Parquet where the file ends so.

    Parameters
    ----------
    table : pyarrow.Table
        The columns to write.
    path : path
        The file, which appears complete or not at all.
    """
    if path.suffix.lower() == ".parquet":
        # In memory first: the file is to appear complete, or not at all.
        sink = pa.BufferOutputStream()
        pq.write_table(table, sink)
        write_atomically(path, sink.getvalue().to_pybytes())
    else:
        write_atomically(path, to_csv(table))


def to_header_row(names: Sequence[str]) -> bytes:
    """Return names as the first row of a CSV file."""
    row = io.StringIO(newline="")
    # A name with either of these characters is quoted; the rows of numbers end as Arrow and numpy end them.
    csv.writer(row, lineterminator="\r\n").writerow(names)
    return row.getvalue().removesuffix("\r\n").encode() + b"\n"


def _to_csv_rows(table: pa.Table, quoting: Literal["none", "needed"]) -> bytes:
    sink = pa.BufferOutputStream()
    pacsv.write_csv(table, sink, pacsv.WriteOptions(include_header=False, quoting_style=quoting))
    return bytes(sink.getvalue())


def table_from_arrays(columns: Mapping[str, NDArray[np.generic]]) -> pa.Table:
    """Return a table of arrays (m,); their names may hold anything, also what is no UTF-8."""
    arrays = [pa.array(values) if values.dtype.kind == "U" else from_numbers(values) for values in columns.values()]
    return pa.table(arrays, names=[escape_surrogates(name) for name in columns])


def open_parquet_stream(path: Path) -> pq.ParquetFile:
    """Open a Parquet file for reading in batches, in memory that does not grow with the file.

    Arrow's defaults keep every byte read until the file is closed, and read a column's whole row group at once.

    Parameters
    ----------
    path : path
        Where the file lies.

    Returns
    -------
    pyarrow.parquet.ParquetFile
        The open file, to be closed by the caller.
    """
    return pq.ParquetFile(path, pre_buffer=False, buffer_size=READ_BYTES)


def to_floats(column: pa.Array) -> FloatArray:
    """Return a column of float64 as a read-only array; missing values are NaN."""
    if column.null_count:
        column = column.fill_null(float("nan"))
    if not len(column):
        return np.empty(0)
    # A column may be a slice of a longer buffer: its offset counts values.
    return np.frombuffer(column.buffers()[1], dtype=np.float64)[column.offset : column.offset + len(column)]


def from_numbers(values: NDArray[np.generic]) -> pa.Array:
    """Return an array (m,) of numbers as a column, without copying if it is contiguous."""
    values = np.ascontiguousarray(values)
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [None, pa.py_buffer(values)])


def batch_from_arrays(values: Mapping[str, NDArray[np.generic]], columns: list[str]) -> pa.RecordBatch:
    """Return some columns of arrays (m,) of numbers, by the columns' names, as a batch."""
    return pa.RecordBatch.from_arrays([from_numbers(values[name]) for name in columns], names=columns)


def table_column_to_numbers(column: pa.ChunkedArray) -> NDArray[np.generic]:
    """Return a table's column as a read-only array of its own kind of number; `ValueError` if values are missing."""
    if column.null_count:
        raise ValueError(f"{column.null_count} values are missing")
    kind = np.dtype(column.type.to_pandas_dtype())
    parts = [
        np.frombuffer(part.buffers()[1], dtype=kind)[part.offset : part.offset + len(part)]
        for part in column.chunks
        if len(part)
    ]
    if len(parts) == 1:
        return parts[0]
    return np.concatenate(parts) if parts else np.empty(0, dtype=kind)


def table_column_to_floats(column: pa.ChunkedArray) -> FloatArray:
    """Return a table's column as float64, read-only if it is that already; `ValueError` if values are missing."""
    return np.asarray(table_column_to_numbers(column), dtype=np.float64)


def parse_numbers(column: pa.Array, decimal_point: str = ".") -> pa.Array:
    """Return a column of text as float64; what is no number is missing."""
    text = pc.utf8_trim_whitespace(column)
    if decimal_point != ".":
        text = pc.replace_substring(text, decimal_point, ".")
    # Arrow's cast fails at the first text that is no number: those become missing before it.
    return pc.if_else(pc.match_substring_regex(text, _NUMBER), text, None).cast(pa.float64())


def is_list(kind: pa.DataType) -> bool:
    """Return whether cells are lists."""
    return bool(pa.types.is_list(kind) or pa.types.is_fixed_size_list(kind) or pa.types.is_large_list(kind))


def is_structure_list(kind: pa.DataType) -> bool:
    """Return whether cells are lists of structures, such as one of each joint."""
    return is_list(kind) and bool(pa.types.is_struct(kind.value_type))


def split_structure_lists(batch: pa.RecordBatch) -> pa.RecordBatch:
    """Return a batch in which lists of structures are structures of lists: positions of all joints, efforts of all."""
    for place, field in enumerate(batch.schema):
        if not is_structure_list(field.type):
            continue
        column = batch.column(place)
        lengths = np.asarray(pc.fill_null(pc.list_value_length(column), 0))
        offsets = pa.array(np.concatenate([[0], np.cumsum(lengths)]).astype(np.int32))
        lists = [pa.ListArray.from_arrays(offsets, part) for part in pc.list_flatten(column).flatten()]
        names = [part.name for part in field.type.value_type.fields]
        batch = batch.set_column(place, field.name, pa.StructArray.from_arrays(lists, names=names))
    return batch
