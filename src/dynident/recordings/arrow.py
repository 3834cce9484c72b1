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

from dynident.arrays import FloatArray, IntArray

READ_BYTES = 1 << 16


def streamed_parquet(path: Path) -> pq.ParquetFile:
    """Open a Parquet file for reading in batches, in memory that does not grow with it.

    Arrow's defaults keep every byte read until the file is closed, and read a column's whole row group at once.
    """
    return pq.ParquetFile(path, pre_buffer=False, buffer_size=READ_BYTES)


def to_floats(column: pa.Array) -> FloatArray:
    """Give a column of float64 as a read-only array; missing values are NaN."""
    if column.null_count:
        column = pc.fill_null(column, float("nan"))
    if not len(column):
        return np.empty(0)
    return np.frombuffer(column.buffers()[1], dtype=np.float64)[column.offset : column.offset + len(column)]


def from_numbers(values: FloatArray | IntArray) -> pa.Array:
    """Give an array (m,) of float64 or int64 as a column."""
    kind = pa.float64() if values.dtype == np.float64 else pa.int64()
    return pa.Array.from_buffers(kind, len(values), [None, pa.py_buffer(np.ascontiguousarray(values))])
