"""Numbers between Arrow and numpy, without the detour over pandas that Arrow's own conversion takes where it is there.

(Importing pandas costs a second and 40 MB, in every process that reads a recording.)
"""

from __future__ import annotations

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dynident.recordings.types import FloatArray, IntArray


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
