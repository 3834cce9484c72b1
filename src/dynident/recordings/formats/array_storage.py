"""Arrays that lie in a file as they do in memory: read part by part, and never whole."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from dynident.array_types import FloatArray
from dynident.recordings.formats.arrays import StoredArray
from dynident.recordings.metadata import RecordingError

_AT_ONCE = 2**20


@dataclass(frozen=True, eq=False)
class ArrayPlace:
    """Where an array lies: the file, the first byte, how numbers are stored, and which axis runs first."""

    file: IO[bytes]
    start: int
    kind: np.dtype[Any]
    shape: tuple[int, ...]
    by_columns: bool

    @property
    def end(self) -> int:
        """The first byte behind the array."""
        return self.start + self.kind.itemsize * math.prod(self.shape)

    def to_array(self, name: str, field: str | None = None) -> StoredArray:
        """Return the array under a name; `field` is one of its records', if it holds some."""
        inner = () if field is None else self.kind[field].shape
        shape = (*self.shape, *inner)

        def read(first: int, last: int, axis: int) -> FloatArray:
            if axis < len(self.shape):
                values = self._read_rows(first, last, axis)
                return np.asarray(values if field is None else values[field], dtype=np.float64)
            # The rows run within the records, of which there are fewer than rows.
            records = self._read_rows(0, self.shape[0], 0)
            return np.array(records[field][:, first:last].T, dtype=np.float64)

        return StoredArray(name, shape, read)

    def _read_rows(self, first: int, last: int, axis: int) -> np.ndarray[Any, Any]:
        """Return the part from `first` to `last` along an axis, which becomes the first axis."""
        lines = self.shape[::-1] if self.by_columns else self.shape
        width = math.prod(lines[1:])
        # Along the slow axis the rows are contiguous; along the other one each line is read in a piece of its own.
        if axis == (len(self.shape) - 1 if self.by_columns else 0):
            return self._read_numbers(first * width, (last - first) * width).reshape(last - first, *lines[1:])
        return np.stack([self._read_numbers(line * width + first, last - first) for line in range(lines[0])], axis=1)

    def _read_numbers(self, first: int, count: int) -> np.ndarray[Any, Any]:
        # Reading at a place moves no position, so that all arrays of a file can share it.
        data = os.pread(self.file.fileno(), count * self.kind.itemsize, self.start + first * self.kind.itemsize)
        return np.frombuffer(data, dtype=self.kind, count=count)


class BoundedFile:
    """A file that is never asked for more bytes than it has left: Python would allocate whatever is requested.

    Parameters
    ----------
    file : binary file
        The open file.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.size = os.fstat(file.fileno()).st_size

    def read(self, size: int = -1) -> bytes:
        """Read at most so many bytes; all that are left if `size` is negative."""
        n_left = max(self.size - self._file.tell(), 0)
        return self._file.read(n_left if size < 0 else min(size, n_left))

    def readline(self, size: int = -1) -> bytes:
        """Read a line."""
        return self._file.readline(size)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Go to a byte."""
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """Return the position of the next byte."""
        return self._file.tell()

    def seekable(self) -> bool:
        """Return True."""
        return True

    def fileno(self) -> int:
        """Return the number of the open file."""
        return self._file.fileno()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class UnpackedParts:
    """The decompressed parts of a file, one behind another in a temporary file, where parts of them can be read.

    Parameters
    ----------
    size : int
        Bytes of all parts.

    Raises
    ------
    RecordingError
        The disk has no room for them.
    """

    def __init__(self, size: int) -> None:
        free = shutil.disk_usage(tempfile.gettempdir()).free
        if size > free:
            detail = f"The file unpacks to {size / 2**20:.0f} MB, and {free / 2**20:.0f} MB are free on the disk."
            raise RecordingError(detail, title="No room")
        self.file: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - it is closed with the arrays that lie in it

    def append(self, read: Callable[[int], bytes], size: int) -> tuple[int, int]:
        """Unpack one more part.

        Parameters
        ----------
        read : callable
            Gives the next bytes, at most so many, and none at the end.
        size : int
            Bytes that it says to unpack to. `ValueError` where there are fewer; more are not read.

        Returns
        -------
        int, int
            Its first byte, and the first one behind it.
        """
        start, n_left = self.file.seek(0, 2), size
        # In pieces, so that memory does not grow with the file.
        while n_left and (part := read(min(_AT_ONCE, n_left))):
            n_left -= len(part)
            self.file.write(part)
        if n_left:
            raise ValueError("a compressed part ends too early")
        # Arrays are read by the file's number, past Python's buffer: what waits in it would be missing.
        self.file.flush()
        return start, start + size
