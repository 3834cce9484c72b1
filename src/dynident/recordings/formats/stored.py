"""Arrays that lie in a file as they do in memory: read part by part, and never whole."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

from dynident.arrays import FloatArray
from dynident.recordings.formats.arrays import StoredArray
from dynident.recordings.types import RecordingError

_AT_ONCE = 2**20
_MOST, _MOST_TIMES = 2**30, 100
"""Bytes that anything may unpack to, and times its size that more may: signals shrink to a tenth at the least, what
shrinks to a thousandth was made to fill a disk."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where an array lies: in which file, from which byte on, how its numbers are stored, and which axis runs first."""

    file: IO[bytes]
    start: int
    kind: np.dtype[Any]
    shape: tuple[int, ...]
    by_columns: bool

    @property
    def end(self) -> int:
        """The first byte behind it."""
        return self.start + self.kind.itemsize * int(np.prod(self.shape, dtype=np.int64))

    def array(self, name: str, field: str | None = None) -> StoredArray:
        """Give it a name; `field` is one of its records', if it holds some."""
        inner = () if field is None else self.kind[field].shape

        def read(first: int, last: int, axis: int) -> FloatArray:
            # Mapped anew each time: what was read before does not stay in memory.
            whole = np.memmap(self.file, self.kind, "r", self.start, self.shape, "F" if self.by_columns else "C")
            values = whole if field is None else whole[field]
            return np.array(values[first:last] if axis == 0 else values[:, first:last].T, dtype=np.float64)

        return StoredArray(name, (*self.shape, *inner), read)


def unpacked(read: Callable[[int], bytes], packed: int) -> IO[bytes]:
    """Write what is stored compressed to a file without a name, where it can be read in parts.

    Parameters
    ----------
    read : callable
        Gives the next bytes, at most so many, and none at the end.
    packed : int
        Bytes that it takes in its file.

    Raises
    ------
    RecordingError
        Where it is many times larger than its file.
    """
    file = tempfile.TemporaryFile()  # noqa: SIM115 - it is closed with the arrays that lie in it
    size = 0
    while part := read(_AT_ONCE):
        size += len(part)
        if size > max(_MOST, _MOST_TIMES * packed):
            raise RecordingError(
                f"What the file holds unpacks to more than {size / 2**30:.0f} GB, from {packed / 2**20:.0f} MB: no "
                "signals shrink so much. Store it without compression if it is right.",
                title="Unreadable file",
            )
        file.write(part)
    file.seek(0)
    return file
