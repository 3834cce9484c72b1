"""MAT files of version 5 to 7: arrays, and structures of arrays.

SciPy reads these files too, but whole: a recording of 2 GB would take twice as much memory. Here it is only found out
where their numbers lie ("MAT-File Format", The MathWorks, chapter 1).
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from dynident.recordings.formats.arrays import ArrayFileSource, StoredArray
from dynident.recordings.formats.stored import Place, unpacked
from dynident.recordings.types import RecordingError

_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""How numbers are stored, by the code of their element; MATLAB keeps whole numbers in fewer bytes."""
_MATRIX, _COMPRESSED = 14, 15
_STRUCTURE, _NUMERIC, _COMPLEX = 2, range(6, 16), 0x800
"""Classes of a matrix: cells, objects, text and sparse ones are neither."""
_HEADER = 128


@dataclass(frozen=True)
class _Element:
    """A part of the file: the code of what it holds, its first byte, and how many there are."""

    code: int
    start: int
    size: int
    following: int


def matlab_source(path: Path) -> ArrayFileSource:
    """Open a MAT file; a field of a structure is called structure.field.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    try:
        return ArrayFileSource(list(_arrays(path.open("rb"))))
    except (ValueError, OSError, zlib.error) as error:
        raise RecordingError(f"The file cannot be read as MAT: {error}", title="Unreadable file") from error


def _arrays(file: IO[bytes]) -> Iterator[StoredArray]:
    size = file.seek(0, 2)
    file.seek(_HEADER - 2)
    order = {b"IM": "<", b"MI": ">"}.get(file.read(2))
    if order is None:
        raise ValueError("its header does not say the order of bytes")
    at = _HEADER
    while at + 8 <= size:
        element = _Reader(file, order, size).element(at)
        if element.code == _COMPRESSED:
            own = _inflated(file, element)
            reader = _Reader(own, order, own.seek(0, 2))
            yield from reader.matrix(reader.element(0))
            at = element.start + element.size  # compressed ones are not filled up to eight bytes
        else:
            yield from _Reader(file, order, size).matrix(element)
            at = element.following


def _inflated(file: IO[bytes], element: _Element) -> IO[bytes]:
    inflate, left = zlib.decompressobj(), element.size
    file.seek(element.start)

    def read(most: int) -> bytes:
        nonlocal left
        while not inflate.eof:
            packed = inflate.unconsumed_tail
            if not packed:
                packed = file.read(min(left, most))
                left -= len(packed)
            if not packed:
                raise ValueError("a compressed part ends too early")
            if part := inflate.decompress(packed, most):
                return part
        return b""

    return unpacked(read, element.size)


class _Reader:
    """Finds the numbers of matrices in a file of `size` bytes, whose order of bytes is `order`."""

    def __init__(self, file: IO[bytes], order: str, size: int) -> None:
        self._file, self._order, self._size = file, order, size

    def element(self, at: int) -> _Element:
        """What begins at a byte; a small one holds its data beside its code."""
        code, size = self._numbers(at, "u4", 2)
        if small := code >> 16:
            element = _Element(code & 0xFFFF, at + 4, small, at + 8)
        else:
            element = _Element(code, at + 8, size, at + 8 + size + -size % 8)
        if element.start + element.size > self._size:
            raise ValueError(f"the part from byte {at} on ends too early")
        return element

    def matrix(self, element: _Element, name: str | None = None) -> Iterator[StoredArray]:
        """The arrays of a matrix: itself, or those of the fields of a structure."""
        if element.code != _MATRIX or not element.size:
            return
        flags = self.element(element.start)
        shape_at = self.element(flags.following)
        own_name = self.element(shape_at.following)
        (flag,) = self._numbers(flags.start, "u4", 1)
        kind = flag & 0xFF
        shape = self._numbers(shape_at.start, "i4", shape_at.size // 4)
        name = name or self._read(own_name.start, own_name.size).decode("latin-1")
        if not name:
            return  # what MATLAB keeps for objects beside the variables
        if kind in _NUMERIC and not flag & _COMPLEX:
            yield from self._array(name, shape, self.element(own_name.following))
        elif kind == _STRUCTURE and int(np.prod(shape)) == 1:
            yield from self._fields(name, own_name.following)

    def _array(self, name: str, shape: tuple[int, ...], numbers: _Element) -> Iterator[StoredArray]:
        kind = np.dtype(self._order + _KINDS[numbers.code]) if numbers.code in _KINDS else None
        shape = tuple(size for size in shape if size != 1)
        if kind is None or not shape:
            return
        if kind.itemsize * int(np.prod(shape, dtype=np.int64)) != numbers.size:
            raise ValueError(f"{name} has not as many numbers as its size says")
        yield Place(self._file, numbers.start, kind, shape, by_columns=True).array(name)

    def _fields(self, name: str, at: int) -> Iterator[StoredArray]:
        longest = self.element(at)
        names = self.element(longest.following)
        width = self._numbers(longest.start, "i4", 1)[0]
        if width < 1:
            raise ValueError(f"the names of the fields of {name} have no length")
        text = self._read(names.start, names.size)
        at = names.following
        for first in range(0, names.size, width):
            field = self.element(at)
            own = text[first : first + width].split(b"\0")[0].decode("latin-1")
            yield from self.matrix(field, f"{name}.{own}")
            at = field.following

    def _numbers(self, at: int, kind: str, count: int) -> tuple[int, ...]:
        kinds = np.dtype(self._order + kind)
        return tuple(np.frombuffer(self._read(at, kinds.itemsize * count), dtype=kinds).tolist())

    def _read(self, at: int, size: int) -> bytes:
        self._file.seek(at)
        data = self._file.read(size)
        if len(data) < size:
            raise ValueError(f"it ends before byte {at + size}")
        return data
