"""Readers of STL, OBJ and PLY meshes, and the choice of reader; the largest file (100 MB).

Mesh libraries are not used on purpose. They read some fifty formats, detect them by content, open the buffers,
materials and archives that a file names, and some damaged files end the process. Mesh files come from strangers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.robot.collada import read_dae

MOST_BYTES = 100 * 2**20
"""Largest file: two million triangles of a binary STL. The meshes of arms have some ten thousand at most."""
# Bytes of a binary STL: its head, which ends with the number of triangles, and one triangle.
_STL_HEAD, _STL_TRIANGLE = 84, 50
_STL_KIND = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")
_LINE_END = re.compile(rb"[\r\n\f\0]+")
_PLY_KINDS = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_PLY_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": ""}

Triangles = tuple[FloatArray, NDArray[np.intp]]
"""Points (m, 3), and triangles (k, 3) as indices of points."""


def read_triangles(file: Path) -> Triangles:
    """Read the triangles of a mesh file.

    Points in the same place become one, and triangles with two equal corners are left out.

    Parameters
    ----------
    file : Path
        The file; the ending of its name tells the format.

    Returns
    -------
    points : ndarray (m, 3)
        In the unit of the file; in m for DAE.
    triangles : ndarray (k, 3)
        Indices of points.

    Raises
    ------
    ValueError
        The file has another ending than .stl, .obj, .ply or .dae, or another content, or is larger than any mesh of a
        robot.
    """
    ending = file.suffix.casefold()
    if ending not in _READERS:
        raise ValueError(f"its name ends in {ending or 'nothing'!r}; supported endings are {', '.join(_READERS)}")
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"it has {size / 2**20:.0f} MB; at most {MOST_BYTES >> 20} MB are allowed")
    try:
        points, corners = _READERS[ending](file.read_bytes())
    except (IndexError, OverflowError) as error:
        raise ValueError(f"it is damaged: {error}") from None
    if not len(points) or not len(corners):
        raise ValueError("it has no triangles")
    if corners.min() < 0 or corners.max() >= len(points):
        raise ValueError(f"its triangles refer to vertex {int(corners.max()) + 1} , but there are {len(points)}")
    # Drop points that no triangle uses, then merge equal ones: an STL repeats each corner for every triangle.
    used = np.unique(corners, return_inverse=True)
    points, places = np.unique(points[used[0]], axis=0, return_inverse=True)
    corners = places.reshape(-1)[used[1].reshape(corners.shape)]
    a, b, c = corners.T
    corners = corners[(a != b) & (b != c) & (c != a)]
    if not len(corners):
        raise ValueError("all of its triangles have the area 0")
    return points, corners


def _read_stl(content: bytes) -> Triangles:
    count = int.from_bytes(content[_STL_HEAD - 4 : _STL_HEAD], "little")
    end = _STL_HEAD + _STL_TRIANGLE * count
    is_text = content.lstrip()[:5].lower() == b"solid"
    # Text begins with "solid", but some programs begin binary files with it too. A length that fits the number of
    # triangles tells these apart.
    if len(content) == end or (count and not is_text and len(content) > end):
        triangles = np.frombuffer(content, dtype=_STL_KIND, count=count, offset=_STL_HEAD)
        points = triangles["corners"].reshape(-1, 3)
    elif is_text:
        points = _parse_floats([word for corner in _VERTEX.findall(content.lower()) for word in corner]).reshape(-1, 3)
    else:
        raise ValueError(
            f"it is not an STL file: it is neither text nor the {count} triangles that its header declares"
        )
    if len(points) % 3:
        raise ValueError(f"it is not an STL file: its number of vertices, {len(points)}, is not a multiple of 3")
    return points.astype(np.float64), np.arange(len(points)).reshape(-1, 3)


def _read_obj(content: bytes) -> Triangles:
    points: list[bytes] = []
    faces: list[list[int]] = []
    for line in _LINE_END.split(re.sub(rb"\\\r?\n", b" ", content)):
        words = line.split()
        if words[:1] == [b"v"]:
            if len(words) < 4:
                raise ValueError(f"it is not an OBJ file: a vertex is {line[:80].decode('latin-1')!a}")
            points += words[1:4]
        elif words[:1] == [b"f"]:
            # OBJ counts corners from 1, and from the last one backward where the number is negative.
            places = [int(word.partition(b"/")[0]) for word in words[1:]]
            faces.append([place - 1 if place > 0 else len(points) // 3 + place for place in places])
    return _parse_floats(points).reshape(-1, 3), split_into_fans(faces)


def _read_ply(content: bytes) -> Triangles:
    head, end_marker, body = content.partition(b"end_header")
    if content[:3] != b"ply" or not end_marker:
        raise ValueError("it is not a PLY file: it has no header")
    lines = [line.decode("latin-1").split() for line in _LINE_END.split(head)]
    order = _PLY_ORDERS.get(next((line[1] for line in lines if line[:1] == ["format"] and len(line) > 1), ""))
    if order is None:
        raise ValueError("it is not a PLY file: its header declares no known format")
    end = re.match(rb"[ \t]*(\r\n|\n|\r)", body)
    rows: Any = _TextRowReader(body) if order == "" else _BinaryRowReader(body[end.end() if end else 0 :], order)
    points, faces = np.empty((0, 3)), np.empty((0, 3), dtype=np.intp)
    for name, count, properties in _read_ply_header(lines):
        # A row takes at least one byte. Checked before reading, because memory is allocated for what the header claims.
        if count > len(content) or not properties:
            raise ValueError(f"its header declares {count} of {name!a}, more than the file can contain")
        columns = rows.read(count, properties)
        if name == "vertex":
            if not {"x", "y", "z"} <= columns.keys():
                raise ValueError("its vertices have no x, y and z")
            points = np.column_stack([np.asarray(columns[axis], dtype=np.float64) for axis in "xyz"])
        elif name == "face":
            places = columns.get("vertex_indices", columns.get("vertex_index"))
            if not isinstance(places, list):
                raise ValueError("its faces have no list vertex_indices")
            faces = split_into_fans(places)
    return points, faces


_Property = tuple[str, str, str]
"""Name, kind of number, and kind of the number of them where it is a list, else ""."""


def _read_ply_header(lines: Sequence[Sequence[str]]) -> list[tuple[str, int, list[_Property]]]:
    elements: list[tuple[str, int, list[_Property]]] = []
    for line in lines:
        if line[:1] == ["element"] and len(line) == 3 and line[2].isdecimal():
            elements.append((line[1], int(line[2][:20]), []))
        elif line[:1] == ["property"] and elements and len(line) in (3, 5):
            kinds = [_PLY_KINDS.get(word) for word in (line[2:4] if line[1] == "list" else line[1:2])]
            if None in kinds or (line[1] == "list") != (len(line) == 5):
                raise ValueError(f"its header has {' '.join(line)[:80]!a}")
            elements[-1][2].append((line[-1], str(kinds[-1]), str(kinds[0]) if line[1] == "list" else ""))
        elif line[:1] in (["element"], ["property"]):
            raise ValueError(f"its header has {' '.join(line)[:80]!a}")
    return elements


class _TextRowReader:
    """The rows of a PLY file in text form."""

    def __init__(self, body: bytes) -> None:
        self._words, self._at = body.split(), 0

    def read(self, count: int, properties: Sequence[_Property]) -> dict[str, Any]:
        """Give the next rows by their properties; lists as lists of places."""
        if not any(length for _, _, length in properties):
            words = self._take(count * len(properties))
            table = _parse_floats(words).reshape(count, len(properties))
            return {name: table[:, k] for k, (name, _, _) in enumerate(properties)}
        columns: dict[str, list[Any]] = {name: [] for name, _, _ in properties}
        for _ in range(count):
            for name, _, length in properties:
                number = int(self._take(1)[0]) if length else 1
                words = self._take(number)
                columns[name].append([int(word) for word in words] if length else float(words[0]))
        return columns

    def _take(self, count: int) -> list[bytes]:
        words = self._words[self._at : self._at + count] if count >= 0 else []
        if len(words) != count:
            raise ValueError("its last rows are missing")
        self._at += count
        return words


class _BinaryRowReader:
    """The rows of a binary PLY file."""

    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._at, self._order = body, 0, order

    def read(self, count: int, properties: Sequence[_Property]) -> dict[str, Any]:
        """Give the next rows by their properties; lists as lists of places."""
        if not any(length for _, _, length in properties):
            row = np.dtype([(f"{k}", self._order + kind) for k, (_, kind, _) in enumerate(properties)])
            table = self._take(row, count)
            return {name: table[f"{k}"] for k, (name, _, _) in enumerate(properties)}
        columns: dict[str, list[Any]] = {name: [] for name, _, _ in properties}
        for _ in range(count):
            for name, kind, length in properties:
                number = int(self._take(np.dtype(self._order + length), 1)[0]) if length else 1
                values = self._take(np.dtype(self._order + kind), number)
                columns[name].append(values.astype(np.int64).tolist() if length else float(values[0]))
        return columns

    def _take(self, kind: np.dtype[Any], count: int) -> NDArray[Any]:
        size = kind.itemsize * count
        if count < 0 or self._at + size > len(self._body):
            raise ValueError("its last rows are missing")
        values = np.frombuffer(self._body, dtype=kind, count=count, offset=self._at)
        self._at += size
        return values


def split_into_fans(faces: Sequence[Sequence[int]]) -> NDArray[np.intp]:
    """Return the triangles (k, 3) of faces as fans about their first corners; faces below three corners have none."""
    triangles = [(face[0], face[k], face[k + 1]) for face in faces for k in range(1, len(face) - 1)]
    return np.array(triangles, dtype=np.intp).reshape(-1, 3)


def _parse_floats(words: Sequence[bytes]) -> FloatArray:
    return np.array(words, dtype=np.bytes_).astype(np.float64)


_READERS: dict[str, Callable[[bytes], Triangles]] = {
    ".stl": _read_stl,
    ".obj": _read_obj,
    ".ply": _read_ply,
    ".dae": read_dae,
}
