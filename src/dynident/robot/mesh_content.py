"""The content of a mesh file as its reader may see it: checked for its sizes, and without the names of other files.

The library that reads meshes knows some fifty formats, tells them by their content, and follows what they name:
buffers, materials, archives. Here four formats are known, and what it is given is written anew.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from xml.parsers import expat

import numpy as np

MOST_BYTES = 100 * 2**20
"""Two million triangles. The meshes of arms have up to some ten thousand."""
_STL_HEAD, _STL_TRIANGLE = 84, 50
_VERTEX = re.compile(rb"\bvertex\s+(\S+)\s+(\S+)\s+(\S+)")
_LINE_END = re.compile(rb"[\r\n\f\0]+")
_ELEMENT = re.compile(rb"^\s*element\s+(\S+)\s+(\S+)", re.MULTILINE)
_DEEPEST = 100
"""Elements of a DAE inside each other; links with their parts take some twenty."""


def plain_mesh(file: Path) -> tuple[str, bytes]:
    """The ending of a mesh file (".stl", ".obj", ".ply" or ".dae") and its content, without references to others.

    Raises
    ------
    ValueError
        The file has another ending or another content, or is larger than any mesh of a robot.
    """
    ending = file.suffix.casefold()
    if ending not in _PLAIN:
        raise ValueError(f"its name ends in {ending or 'nothing'!r}, which is none of {', '.join(_PLAIN)}")
    size = file.stat().st_size
    if size > MOST_BYTES:
        raise ValueError(f"it has {size / 2**20:.0f} MB; at most {MOST_BYTES >> 20} MB are read")
    return ending, _PLAIN[ending](file.read_bytes())


def _plain_stl(content: bytes) -> bytes:
    """A binary STL of the same triangles."""
    count = int.from_bytes(content[_STL_HEAD - 4 : _STL_HEAD], "little")
    end = _STL_HEAD + _STL_TRIANGLE * count
    is_text = content.lstrip()[:5].lower() == b"solid"
    if len(content) == end or (count and not is_text and len(content) > end >= _STL_HEAD):
        return _binary_stl(content[_STL_HEAD:end], count)
    if not is_text:
        raise ValueError(f"it is no STL: neither text nor the {count} triangles that its header names")
    corners = _VERTEX.findall(content.lower())
    if not corners or len(corners) % 3:
        raise ValueError(f"it is no STL: its text holds {len(corners)} corners of triangles")
    try:
        points = np.array(corners).astype(np.float32)
    except ValueError as error:
        raise ValueError(f"it is no STL: {error}") from None
    triangles = np.zeros(len(points) // 3, dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    triangles["corners"] = points.reshape(-1, 3, 3)
    return _binary_stl(triangles.tobytes(), len(triangles))


def _binary_stl(triangles: bytes, count: int) -> bytes:
    return bytes(_STL_HEAD - 4) + count.to_bytes(4, "little") + triangles


def _plain_obj(content: bytes) -> bytes:
    """The corners and faces of an OBJ alone: other lines name materials, textures, or say nothing of the shape."""
    lines = []
    for line in _LINE_END.split(re.sub(rb"\\\r?\n", b" ", content)):
        words = line.split()
        if words[:1] == [b"v"]:
            lines.append(b"v " + b" ".join(words[1:4]))
        elif words[:1] == [b"f"]:
            lines.append(b"f " + b" ".join(word.partition(b"/")[0] for word in words[1:]))
    if not any(line.startswith(b"v") for line in lines):
        raise ValueError("it is no OBJ: it has no line of a corner (v x y z)")
    return b"\n".join(lines) + b"\n"


def _plain_ply(content: bytes) -> bytes:
    """A PLY whose header asks for no more than the file can hold."""
    head, end, _ = content.partition(b"end_header")
    if content[:3] != b"ply" or not end:
        raise ValueError("it is no PLY: it has no header")
    for name, number in _ELEMENT.findall(head):
        # An element takes one byte at the least.
        if not number.isdigit() or int(number[:20]) > len(content):
            raise ValueError(f"its header names {ascii(number.decode('latin-1'))} of {ascii(name.decode('latin-1'))}")
    return content


def _plain_dae(content: bytes) -> bytes:
    """A DAE whose counts are no larger than the file."""
    depth = 0
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 1 and tag != "COLLADA":
            raise ValueError(f"it is no DAE: its root element is <{tag}>, not <COLLADA>")
        if depth > _DEEPEST:
            raise ValueError(f"<{tag}> is inside more than {_DEEPEST} other elements")
        for name in ("count", "stride", "offset"):
            number = attributes.get(name, "0").strip()
            if not number.isdigit() or int(number[:20]) > len(content):
                raise ValueError(f"its <{tag}> has {name}={number[:40]!a}, more than the file can hold")

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    def doctype(*_: object) -> None:
        raise ValueError("it has a document type declaration; remove <!DOCTYPE …>")

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise ValueError(f"it is no DAE: line {error.lineno}: {expat.ErrorString(error.code)}") from None
    return content


_PLAIN: dict[str, Callable[[bytes], bytes]] = {
    ".stl": _plain_stl,
    ".obj": _plain_obj,
    ".ply": _plain_ply,
    ".dae": _plain_dae,
}
