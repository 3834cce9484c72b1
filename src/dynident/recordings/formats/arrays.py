"""Files that hold arrays by name (MAT, HDF5, NumPy): arrays of one common length are the columns of the recording."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow import from_numbers
from dynident.recordings.file_limits import TITLE, check_columns, choose_block_rows
from dynident.recordings.file_source import FileSource
from dynident.recordings.metadata import RecordingError

FEWEST_ROWS = 8
"""Arrays that are shorter both ways are settings, not signals."""


@dataclass(frozen=True, eq=False)
class StoredArray:
    """One array of a file: its name, its shape (one or two axes), and the function that reads a part of it.

    `read(first, last, axis)` takes the axis that the rows run along, and returns (rows, width) or (rows,).
    """

    name: str
    shape: tuple[int, ...]
    read: Callable[[int, int, int], FloatArray]


@dataclass(frozen=True, eq=False)
class _ArrayColumn:
    stored: StoredArray
    axis: int
    index: int


class ArrayFileSource(FileSource):
    """The arrays of a file as columns: an array q of m x 6 is q1 … q6, whichever way it lies."""

    def __init__(self, arrays: Sequence[StoredArray]) -> None:
        self._places: dict[str, _ArrayColumn] = {}
        arrays = [
            array
            for array in arrays
            if 1 <= len(array.shape) <= 2 and min(array.shape) > 0 and max(array.shape) >= FEWEST_ROWS
        ]
        if not arrays:
            raise RecordingError("The file holds no arrays of numbers with rows.", title=TITLE)
        # Arrays do not say which of their axes is time: it is the length that they share.
        self._length = _find_length(arrays)
        # The common group is stripped of names before arrays of other lengths, settings mostly, are left out.
        prefix = _find_prefix([array.name for array in arrays])
        arrays = [array for array in arrays if self._length in array.shape]
        check_columns(sum(math.prod(array.shape) // self._length for array in arrays))
        for array in arrays:
            axis = array.shape.index(self._length)
            width = array.shape[1 - axis] if len(array.shape) == 2 else 1
            name = array.name[len(prefix) :] or "column"
            joint = "_" if name[-1].isdigit() else ""
            for index in range(width):
                column = name if width == 1 else f"{name}{joint}{index + 1}"
                self._places[column] = _ArrayColumn(array, axis, index)
        super().__init__(list(self._places))

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        # Arrays of several columns are read once for each block, not once for each column.
        step = choose_block_rows(len(self._places))
        for first in range(0, self._length, step):
            last = min(first + step, self._length)
            blocks: dict[int, FloatArray] = {}
            values = []
            for column in columns:
                place = self._places[column]
                whole = blocks.get(id(place.stored))
                if whole is None:
                    whole = blocks[id(place.stored)] = _read_rows(place, first, last)
                values.append(from_numbers(np.asarray(whole[:, place.index], dtype=np.float64)))
            yield pa.RecordBatch.from_arrays(values, names=columns)


def _read_rows(place: _ArrayColumn, first: int, last: int) -> FloatArray:
    """Read the rows of an array, and say which array it is if that fails."""
    try:
        return place.stored.read(first, last, place.axis).reshape(last - first, -1)
    except (OSError, RuntimeError, TypeError, ValueError, ArithmeticError) as error:
        raise RecordingError(
            f"{place.stored.name} cannot be read from row {first + 1} on: {error}",
            pointer=place.stored.name,
            title=TITLE,
        ) from error


def _find_length(arrays: Sequence[StoredArray]) -> int:
    """Return the number of rows: the length that most columns share, and of these the largest.

    It is the longer side of one array at the least: a recording has more rows than signals.
    """
    longer = {max(array.shape) for array in arrays}
    shared: Counter[int] = Counter()
    for array in arrays:
        for axis, size in enumerate(array.shape):
            if size >= FEWEST_ROWS and size in longer:
                # A square or wide array of settings may have many columns: it counts as no more than 64.
                shared[size] += min(64, array.shape[1 - axis]) if len(array.shape) == 2 else 1
    return max(shared, key=lambda size: (shared[size], size))


def _find_prefix(names: Sequence[str]) -> str:
    """Return the group that all arrays are in, which says nothing."""
    if len(names) < 2:
        return ""
    shortest = min(names, key=len)
    for cut in range(len(shortest), 0, -1):
        if shortest[cut - 1] in "./" and all(name.startswith(shortest[:cut]) for name in names):
            return shortest[:cut]
    return ""
