"""Reader of MAT files, versions 5 to 7.

SciPy reads these files too, but whole: a recording of 2 GB would take twice as much memory. Here it is only found out
where their numbers lie ("MAT-File Format", The MathWorks, chapter 1).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO

import numpy as np

from dynident.recordings.file_size_limits import (
    DEEPEST,
    check_columns,
    check_unpacked,
    make_damaged_error,
)
from dynident.recordings.formats.array_files import (
    FEWEST_ROWS,
    ArrayFileSource,
    ArrayPlace,
    StoredArray,
    UnpackedParts,
    count_name,
)
from dynident.recordings.recording_metadata import RecordingError

_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""How numbers are stored, by the code of their element; MATLAB keeps whole numbers in fewer bytes."""
_MATRIX, _COMPRESSED = 14, 15
_CELLS, _STRUCTURE, _TEXT, _NUMERIC, _COMPLEX = 1, 2, 4, range(6, 16), 0x800
"""Classes of a matrix: cells, objects, text and sparse ones are neither."""
_MOST_CELLS = 64
"""Cells, or structures in one array, that may be joints or signals."""
_LABELS, _VALUES = ("label", "name", "Name"), ("values", "data", "Data")
"""Fields of a structure that say what a signal is called, and hold its numbers, as Simulink's scopes write them."""
_LONGEST_LABEL = 512
"""Bytes of the matrix of such a name."""
_WIDE = (4, 17)
"""Codes of text whose letters have two bytes."""
_HEADER = 128
_READ_BYTES = 2**16


@dataclass(frozen=True)
class _Element:
    """A part of the file: the code of what it holds, its first byte, and how many there are."""

    code: int
    start: int
    size: int
    following: int


def open_matlab(path: Path) -> ArrayFileSource:
    """Open a MAT file; a field of a structure is called structure.field.

    Parameters
    ----------
    path : path
        Where the file lies.

    Returns
    -------
    ArrayFileSource
        The arrays of one common length, as columns.

    Raises
    ------
    RecordingError
        For a file that cannot be read.
    """
    try:
        rows: list[str] = []
        return ArrayFileSource(list(_read_arrays(path.open("rb"), rows)), rows=rows)
    except RecordingError:
        raise
    except (ValueError, OSError, zlib.error) as error:
        raise make_damaged_error("MAT", error) from error


def _read_arrays(file: IO[bytes], rows: list[str]) -> Iterator[StoredArray]:
    """Yield the arrays of numbers; names of arrays of many structures, which may be rows, go to `rows`."""
    size = file.seek(0, 2)
    file.seek(_HEADER - 2)
    order = {b"IM": "<", b"MI": ">"}.get(file.read(2))
    if order is None:
        raise ValueError("its header does not state the byte order")
    reader = _MatrixReader(file, order, size, rows)
    elements = list(_read_elements(reader, size))
    sizes = {
        element.start: _read_unpacked_size(file, element, order) for element in elements if element.code == _COMPRESSED
    }
    # All compressed parts together are checked before the first is unpacked to disk.
    check_unpacked(sum(sizes.values()), size)
    # Arrays are read in parts later on, which a compressed stream does not allow: it is unpacked to disk once.
    unpacked = UnpackedParts(sum(sizes.values())) if sizes else None
    for element in elements:
        if element.start not in sizes or unpacked is None:
            yield from reader.read_matrix(element)
            continue
        start, end = unpacked.append(_make_inflater(file, element), sizes[element.start])
        inner = _MatrixReader(unpacked.file, order, end, rows)
        yield from inner.read_matrix(inner.read_element(start))


def _read_elements(reader: _MatrixReader, size: int) -> Iterator[_Element]:
    """Yield the elements of the file, one behind another."""
    at, number = _HEADER, 0
    while at + 8 <= size:
        element = reader.read_element(at)
        number += 1
        check_columns(number)
        yield element
        # Compressed ones are not filled up to eight bytes.
        at = element.start + element.size if element.code == _COMPRESSED else element.following


def _read_unpacked_size(file: IO[bytes], element: _Element, order: str) -> int:
    """Return the bytes that a compressed part unpacks to: it begins with a code and the size of what follows."""
    next_bytes = _make_inflater(file, element)
    head = b""
    while len(head) < 8 and (part := next_bytes(8 - len(head))):
        head += part
    if len(head) < 8:
        raise ValueError("a compressed part ends too early")
    code, size = np.frombuffer(head, dtype=f"{order}u4").tolist()
    # A small element has its size in the upper half of its code, and its data in the same eight bytes.
    return 8 if code >> 16 else 8 + int(size)


def _make_inflater(file: IO[bytes], element: _Element) -> Callable[[int], bytes]:
    """Return a function that gives the next bytes of a compressed part, at most as many as are requested."""
    inflate, at = zlib.decompressobj(), element.start

    def read(most: int) -> bytes:
        nonlocal at
        while not inflate.eof:
            packed = inflate.unconsumed_tail
            if not packed:
                file.seek(at)
                packed = file.read(min(element.start + element.size - at, _READ_BYTES))
                at += len(packed)
            if not packed:
                raise ValueError("a compressed part ends too early")
            if part := inflate.decompress(packed, most):
                return part
        return b""

    return read


class _MatrixReader:
    """Finds the numbers of matrices in a file of `size` bytes, whose order of bytes is `order`."""

    def __init__(self, file: IO[bytes], order: str, size: int, rows: list[str]) -> None:
        self._file, self._order, self._size, self._rows = file, order, size, rows

    def read_element(self, at: int) -> _Element:
        """Return the element that begins at a byte; a small one holds its data beside its code."""
        code, size = self._read_numbers(at, "u4", 2)
        if small := code >> 16:
            element = _Element(code & 0xFFFF, at + 4, small, at + 8)
        else:
            # Elements are padded to multiples of eight bytes.
            element = _Element(code, at + 8, size, at + 8 + size + -size % 8)
        if element.start + element.size > self._size:
            raise ValueError(f"the part from byte {at} on ends too early")
        return element

    def read_matrix(self, element: _Element, name: str | None = None, depth: int = 0) -> Iterator[StoredArray]:
        """Yield the arrays of a matrix: itself, or those of the fields of a structure."""
        if element.code != _MATRIX or not element.size:
            return
        if depth > DEEPEST:
            raise ValueError(f"it contains structures more than {DEEPEST} levels deep")
        flags = self.read_element(element.start)
        shape_at = self.read_element(flags.following)
        own_name = self.read_element(shape_at.following)
        (flag,) = self._read_numbers(flags.start, "u4", 1)
        kind = flag & 0xFF
        shape = self._read_numbers(shape_at.start, "i4", shape_at.size // 4)
        name = name or self._read_bytes(own_name.start, own_name.size).decode("latin-1")
        if not name:
            return  # what MATLAB keeps for objects beside the variables
        if kind in _NUMERIC and not flag & _COMPLEX:
            yield from self._read_array(name, shape, self.read_element(own_name.following))
        elif kind == _STRUCTURE and math.prod(shape) > 0:
            if math.prod(shape) >= FEWEST_ROWS:
                self._rows.append(name)
            if math.prod(shape) <= _MOST_CELLS:
                yield from self._read_fields(name, own_name.following, math.prod(shape), depth + 1)
        elif kind == _CELLS:
            yield from self._read_cells(name, own_name.following, math.prod(shape), element.start + element.size, depth)

    def _read_array(self, name: str, shape: tuple[int, ...], numbers: _Element) -> Iterator[StoredArray]:
        kind = np.dtype(self._order + _KINDS[numbers.code]) if numbers.code in _KINDS else None
        shape = tuple(size for size in shape if size != 1) or (1,)
        if kind is None:
            return
        # What a header says is checked against the bytes that are there: nothing is allocated by it.
        if min(shape) < 0 or kind.itemsize * math.prod(shape) != numbers.size:
            raise ValueError(f"the size of {name} does not match how many numbers it has")
        yield ArrayPlace(self._file, numbers.start, kind, shape, by_columns=True).to_array(name)

    def _read_cells(self, name: str, at: int, count: int, end: int, depth: int) -> Iterator[StoredArray]:
        """Yield the arrays in cells, q{1} and so on, numbered in their order."""
        if not 0 <= count <= _MOST_CELLS:
            return  # of episodes or texts, not of joints
        for number in range(1, count + 1):
            if at >= end:
                raise ValueError(f"{name} ends before its cell {number}")
            cell = self.read_element(at)
            yield from self.read_matrix(cell, count_name(name, number), depth + 1)
            at = cell.following

    def _read_fields(self, name: str, at: int, count: int, depth: int) -> Iterator[StoredArray]:
        """Yield the arrays of `count` structures with the same fields, called by their labels or by numbers."""
        longest = self.read_element(at)
        names = self.read_element(longest.following)
        width = self._read_numbers(longest.start, "i4", 1)[0]
        if width < 1:
            raise ValueError(f"the field names of {name} have the length 0")
        text = self._read_bytes(names.start, names.size)
        fields = [
            text[first : first + width].split(b"\0")[0].decode("latin-1") for first in range(0, names.size, width)
        ]
        at = names.following
        for number in range(1, count + 1):
            elements: dict[str, _Element] = {}
            for field in fields:
                elements[field] = self.read_element(at)
                at = elements[field].following
            whole = name if count == 1 else count_name(name, number)
            label = next(filter(None, (self._read_text(elements[field]) for field in fields if field in _LABELS)), "")
            for field, element in elements.items():
                own = f"{whole}.{field}"
                for array in self.read_matrix(element, own, depth):
                    # What stands deeper keeps its own label, or none.
                    is_labelled = bool(label) and array.name == own and field in _VALUES
                    yield replace(array, label=label) if is_labelled else array

    def _read_text(self, element: _Element) -> str:
        """Return the text of a matrix of characters; "" where it is none, or a long one."""
        if element.code != _MATRIX or not 0 < element.size <= _LONGEST_LABEL:
            return ""
        flags = self.read_element(element.start)
        (flag,) = self._read_numbers(flags.start, "u4", 1)
        if flag & 0xFF != _TEXT:
            return ""
        name = self.read_element(self.read_element(flags.following).following)
        letters = self.read_element(name.following)
        data = self._read_bytes(letters.start, letters.size)
        return (
            data.decode(
                f"utf-16-{'le' if self._order == '<' else 'be'}" if letters.code in _WIDE else "utf-8", errors="replace"
            )
            .replace("\0", "")
            .strip()
        )

    def _read_numbers(self, at: int, kind: str, count: int) -> tuple[int, ...]:
        kinds = np.dtype(self._order + kind)
        return tuple(np.frombuffer(self._read_bytes(at, kinds.itemsize * count), dtype=kinds).tolist())

    def _read_bytes(self, at: int, size: int) -> bytes:
        self._file.seek(at)
        data = self._file.read(size)
        if len(data) < size:
            raise ValueError(f"it ends before byte {at + size}")
        return data
