"""Arrow at the border: files read in a stream, and columns as numpy arrays and back.

Arrow's own conversion takes a detour over pandas where that is installed, which costs a second and 40 MB in every
process that reads a recording.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynident.arrays import FloatArray

READ_BYTES = 1 << 16
_NUMBER = r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"


def streamed_parquet(path: Path) -> pq.ParquetFile:
    """Open a Parquet file for reading in batches, in memory that does not grow with it.

    Arrow's defaults keep every byte read until the file is closed, and read a column's whole row group at once.
    """
    return pq.ParquetFile(path, pre_buffer=False, buffer_size=READ_BYTES)


def to_floats(column: pa.Array) -> FloatArray:
    """Give a column of float64 as a read-only array; missing values are NaN."""
    if column.null_count:
        column = column.fill_null(float("nan"))
    if not len(column):
        return np.empty(0)
    return np.frombuffer(column.buffers()[1], dtype=np.float64)[column.offset : column.offset + len(column)]


def from_numbers(values: NDArray[np.generic]) -> pa.Array:
    """Give an array (m,) of numbers as a column."""
    values = np.ascontiguousarray(values)
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [None, pa.py_buffer(values)])


def to_numbers(column: pa.ChunkedArray) -> NDArray[np.generic]:
    """Give a table's column as a read-only array of its own kind of number; `ValueError` where values are missing."""
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


def as_floats(column: pa.ChunkedArray) -> FloatArray:
    """Give a table's column as float64, read-only where it is that already; `ValueError` where values are missing."""
    return np.asarray(to_numbers(column), dtype=np.float64)


def numbers_of_text(column: pa.Array, decimal_point: str = ".") -> pa.Array:
    """Give a column of text as float64; what is no number is missing."""
    text = pc.utf8_trim_whitespace(column)
    if decimal_point != ".":
        text = pc.replace_substring(text, decimal_point, ".")
    return pc.if_else(pc.match_substring_regex(text, _NUMBER), text, None).cast(pa.float64())
