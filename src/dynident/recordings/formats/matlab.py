"""Reader of MAT files, versions 4 to 7.

SciPy reads these files too, but whole: a recording of 2 GB would take twice as much memory. Here it is only found out
where their numbers lie ("MAT-File Format", The MathWorks, chapters 1 and 2).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import IO

import numpy as np

from dynident.recordings.file_size_limits import (
    DEEPEST,
    UnpackedParts,
    check_columns,
    check_unpacked,
    make_damaged_error,
)
from dynident.recordings.formats.array_files import (
    FEWEST_ROWS,
    ArrayFileSource,
    ArrayPlace,
    StoredArray,
    count_name,
)
from dynident.recordings.recording_metadata import RecordingError

_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""How numbers are stored, by the code of their element; MATLAB keeps whole numbers in fewer bytes."""
_MATRIX, _COMPRESSED = 14, 15
_CELLS, _STRUCTURE, _TEXT, _NUMERIC, _OBJECT, _COMPLEX = 1, 2, 4, range(6, 16), 17, 0x800
"""Classes of a matrix: cells, objects, text and sparse ones are neither."""
_KINDS_OF_4 = ("f8", "f4", "i4", "i2", "u2", "u1")
"""How version 4 stores numbers, by the third last digit of the type of a matrix."""
_HEADER_OF_4 = 20
"""Bytes before a matrix of version 4: its type, rows, columns, whether it is complex, and the length of its name."""
_LONGEST_NAME = 64
"""Bytes of a name in version 4, at most: MATLAB's own names are shorter."""
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
        unread: dict[str, str] = {}
        file = path.open("rb")
        start = file.read(_HEADER_OF_4)
        arrays = _read_version_4(file) if is_version_4(start) else _read_arrays(file, unread)
        return ArrayFileSource(list(arrays), unread=unread)
    except RecordingError:
        raise
    except (ValueError, OSError, zlib.error) as error:
        raise make_damaged_error("MAT", error) from error


def describe_rows(name: str, kind: str, listed: str) -> str:
    """Return what to do about a variable that has one structure or cell for each row.

    Parameters
    ----------
    name : str
        The variable.
    kind : str
        What it is, such as "an array of structures".
    listed : str
        All of them, as MATLAB lists them.
    """
    return f"{name} is {kind}, one for each row: save a matrix for each signal instead, as q = vertcat({listed})."


def describe_object(name: str, kind: str) -> str:
    """Return what to do about an object of MATLAB, whose numbers no other program finds.

    Parameters
    ----------
    name : str
        The variable.
    kind : str
        Its class, such as "table".
    """
    way = _WAYS.get(kind, "save('run.mat', 't', 'q', 'tau')").format(name)
    return f"{name} is an object of MATLAB ({kind}): save its numbers as matrices or text in MATLAB, {way}."


_WAYS = {
    "table": "writetable({0}, 'run.csv')",
    "timetable": "writetimetable({0}, 'run.csv')",
    "string": "{0} = double({0}) if it holds numbers",
    "datetime": "{0} = seconds({0} - {0}(1))",
    "duration": "{0} = seconds({0})",
}
"""What MATLAB makes numbers, or text, of an object with, by its class."""


def is_version_4(start: bytes) -> bool:
    """Tell whether a file begins as MAT files of version 4 do, which have no mark of their own.

    Parameters
    ----------
    start : bytes
        The first bytes of the file.
    """
    if len(start) < _HEADER_OF_4:
        return False
    order = "<" if start[3] == 0 else ">"
    kind, n_rows, n_columns, is_complex, length = np.frombuffer(start[:_HEADER_OF_4], dtype=f"{order}i4").tolist()
    # The type is MOPT in decimal digits: order of bytes, 0, kind of number, and what the matrix is.
    thousands, hundreds, tens, ones = (kind // 10**power % 10 for power in (3, 2, 1, 0))
    is_type = 0 <= kind < 2000 and thousands == (order == ">") and not hundreds and tens < len(_KINDS_OF_4) and ones < 3
    return is_type and min(n_rows, n_columns) >= 0 and is_complex in (0, 1) and 1 < length <= _LONGEST_NAME


def _read_version_4(file: IO[bytes]) -> Iterator[StoredArray]:
    """Yield the matrices of numbers of a file of version 4, which stand one behind another."""
    size, at = file.seek(0, 2), 0
    for number in count(1):
        check_columns(number)
        file.seek(at)
        if not is_version_4(start := file.read(_HEADER_OF_4)):
            raise ValueError(f"no matrix begins at byte {at}")
        order = "<" if start[3] == 0 else ">"
        code, n_rows, n_columns, is_complex, length = np.frombuffer(start, dtype=f"{order}i4").tolist()
        kind = np.dtype(order + _KINDS_OF_4[code // 10 % 10])
        name = file.read(length).rstrip(b"\0").decode("latin-1")
        begin = at + _HEADER_OF_4 + length
        at = begin + kind.itemsize * n_rows * n_columns * (1 + is_complex)
        if at > size:
            raise ValueError(f"the numbers of {name} end too early")
        if code % 10 == 0 and not is_complex:
            shape = tuple(axis for axis in (n_rows, n_columns) if axis != 1) or (1,)
            yield ArrayPlace(file, begin, kind, shape, by_columns=True).to_array(name)
        if at == size:
            return


def _read_arrays(file: IO[bytes], unread: dict[str, str]) -> Iterator[StoredArray]:
    """Yield the arrays of numbers; variables that cannot be read, and what to do about each, go to `unread`."""
    size = file.seek(0, 2)
    file.seek(_HEADER - 2)
    order = {b"IM": "<", b"MI": ">"}.get(file.read(2))
    if order is None:
        raise ValueError("its header does not state the byte order")
    reader = _MatrixReader(file, order, size, unread)
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
        inner = _MatrixReader(unpacked.file, order, end, unread)
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

    def __init__(self, file: IO[bytes], order: str, size: int, unread: dict[str, str]) -> None:
        self._file, self._order, self._size, self._unread = file, order, size, unread

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
        if kind == _OBJECT:
            # Their name stands in the place of the shape, and their class behind the word MCOS.
            texts = (shape_at, own_name, self.read_element(own_name.following))
            variable, _, kind_of = (self._read_bytes(text.start, text.size).decode("latin-1") for text in texts)
            # One in a cell or a structure has no name of its own.
            known = variable or name or "data"
            self._unread[known] = describe_object(known, kind_of)
            return
        shape = self._read_numbers(shape_at.start, "i4", shape_at.size // 4)
        name = name or self._read_bytes(own_name.start, own_name.size).decode("latin-1")
        if not name:
            return  # what MATLAB keeps for objects beside the variables
        if kind in _NUMERIC and not flag & _COMPLEX:
            yield from self._read_array(name, shape, self.read_element(own_name.following))
        elif kind == _STRUCTURE and math.prod(shape) > 0:
            if math.prod(shape) >= FEWEST_ROWS:
                self._unread[name] = describe_rows(name, "an array of structures", f"{name}.q")
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
            # Many cells are rows or words, not joints; words are no signal.
            if self._read_class(self.read_element(at)) != _TEXT:
                self._unread[name] = describe_rows(name, "a cell array", f"{name}{{:}}")
            return
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
        if not 0 < element.size <= _LONGEST_LABEL or self._read_class(element) != _TEXT:
            return ""
        shape = self.read_element(self.read_element(element.start).following)
        name = self.read_element(shape.following)
        letters = self.read_element(name.following)
        data = self._read_bytes(letters.start, letters.size)
        return (
            data.decode(
                f"utf-16-{'le' if self._order == '<' else 'be'}" if letters.code in _WIDE else "utf-8", errors="replace"
            )
            .replace("\0", "")
            .strip()
        )

    def _read_class(self, element: _Element) -> int:
        """Return the class of a matrix; 0 of an empty one, and where the element is none."""
        if element.code != _MATRIX or not element.size:
            return 0
        return self._read_numbers(self.read_element(element.start).start, "u4", 1)[0] & 0xFF

    def _read_numbers(self, at: int, kind: str, count: int) -> tuple[int, ...]:
        kinds = np.dtype(self._order + kind)
        return tuple(np.frombuffer(self._read_bytes(at, kinds.itemsize * count), dtype=kinds).tolist())

    def _read_bytes(self, at: int, size: int) -> bytes:
        self._file.seek(at)
        data = self._file.read(size)
        if len(data) < size:
            raise ValueError(f"it ends before byte {at + size}")
        return data
