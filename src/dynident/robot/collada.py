"""Reader of COLLADA (.dae) meshes: triangles in metres."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree import ElementTree
from xml.etree.ElementTree import Element
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray

DEEPEST = 100
"""Elements inside each other, and nodes of a scene; links with their parts take some twenty."""
_MOST_INSTANCES = 10_000
_MOST_CORNERS = 10_000_000
"""Geometries that stand in a scene, and the corners of all of them: each may stand there many times."""
_PRIMITIVES = ("triangles", "polylist", "polygons", "tristrips", "trifans")


def read_dae(content: bytes) -> tuple[FloatArray, NDArray[np.intp]]:
    """Return all triangles of the scene, each geometry placed where the scene's nodes put it.

    The `up_axis` of the file is ignored, as by other readers of robot meshes: a link's axes are those of its mesh.

    Parameters
    ----------
    content : bytes
        The whole file.

    Returns
    -------
    points : ndarray (m, 3)
        Corners in m.
    triangles : ndarray (k, 3)
        Indices of corners.

    Raises
    ------
    ValueError
        The text is no COLLADA, is damaged, or asks for more than a mesh of a robot has.
    """
    check_document(content)
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError as error:
        raise ValueError(f"it is not a DAE file: {error}") from None
    # COLLADA 1.4 and 1.5 differ in their namespace, and nothing here depends on it: drop it from every tag.
    for element in root.iter():
        element.tag = element.tag.rpartition("}")[2]
    scene = _Scene(root)
    points: list[FloatArray] = []
    triangles: list[NDArray[np.intp]] = []
    corners = 0
    for count, (placement, geometry) in enumerate(scene.iter_instances(), start=1):
        own_points, own_triangles = scene.read_triangles(geometry)
        points.append(own_points @ placement[:3, :3].T + placement[:3, 3])
        triangles.append(own_triangles + corners)
        corners += len(own_points)
        # A small file can instance one geometry many times. Checking here bounds the memory that it can claim.
        if corners > _MOST_CORNERS or count > _MOST_INSTANCES:
            raise ValueError(f"its scene has more than {_MOST_INSTANCES} parts, or {_MOST_CORNERS} corners")
    if not points:
        raise ValueError("it has no triangles")
    return np.concatenate(points) * scene.metre, np.concatenate(triangles)


def check_document(content: bytes) -> None:
    """Refuse what is not COLLADA, has a document type (entities could grow without end), or is too deep."""
    depth = 0
    parser = expat.ParserCreate()

    def start(tag: str, _: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        if depth == 1 and tag.rpartition(":")[2] != "COLLADA":
            raise ValueError(f"it is not a DAE file: its root element is <{tag[:80]}>, not <COLLADA>")
        if depth > DEEPEST:
            raise ValueError(f"its elements are nested more than {DEEPEST} levels deep")

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
        raise ValueError(f"it is not a DAE file: line {error.lineno}: {expat.ErrorString(error.code)}") from None
    except LookupError as error:
        raise ValueError(f"it is not a DAE file: {error}") from None


class _Scene:
    """The elements of a file by their ids, and the geometries that its scene places."""

    def __init__(self, root: Element) -> None:
        self._root = root
        self._named = {element.attrib["id"]: element for element in root.iter() if "id" in element.attrib}
        self._read: dict[str, tuple[FloatArray, NDArray[np.intp]]] = {}
        unit = root.find("asset/unit")
        metre = _parse_floats("1" if unit is None else unit.attrib.get("meter", "1"))
        self.metre = float(metre[0]) if len(metre) == 1 else np.nan
        if not 0.0 < self.metre < np.inf:
            raise ValueError("its unit is not a length")

    def iter_instances(self) -> Iterator[tuple[FloatArray, Element]]:
        """Yield the placement (4, 4) and element of each geometry; without a scene all are at the origin."""
        begin = self._root.find("scene/instance_visual_scene")
        if begin is None:
            yield from ((np.eye(4), geometry) for geometry in self._root.iter("geometry"))
            return
        # Walk the tree of nodes with a stack of our own: recursion would follow a cycle of instances to the end of
        # Python's stack, while the limits on depth and count stop it here.
        waiting = [(self._resolve_reference(begin, "url", "visual_scene"), np.eye(4), 0)]
        count = 0
        while waiting:
            node, placement, depth = waiting.pop()
            count += 1
            if depth > DEEPEST or count > _MOST_INSTANCES:
                raise ValueError(
                    f"its scene has more than {_MOST_INSTANCES} nodes, or nodes nested more than {DEEPEST} levels deep"
                )
            for child in node:
                placement = placement @ _read_transform(child)
            for child in node:
                if child.tag == "node":
                    waiting.append((child, placement, depth + 1))
                elif child.tag == "instance_node":
                    waiting.append((self._resolve_reference(child, "url", "node"), placement, depth + 1))
                elif child.tag == "instance_geometry":
                    yield placement, self._resolve_reference(child, "url", "geometry")

    def read_triangles(self, geometry: Element) -> tuple[FloatArray, NDArray[np.intp]]:
        """Return points and triangles of a geometry in its own coordinates; each geometry is read once."""
        name = geometry.attrib.get("id", "")
        if name not in self._read:
            parts = [
                self._read_primitive(primitive)
                for mesh in geometry.findall("mesh")
                for primitive in mesh
                if primitive.tag in _PRIMITIVES
            ]
            sizes = np.cumsum([0, *(len(points) for points, _ in parts)])
            self._read[name] = (
                np.concatenate([np.empty((0, 3)), *(points for points, _ in parts)]),
                np.concatenate(
                    [
                        np.empty((0, 3), np.intp),
                        *(corners + first_corner for (_, corners), first_corner in zip(parts, sizes, strict=False)),
                    ]
                ),
            )
        return self._read[name]

    def _read_primitive(self, element: Element) -> tuple[FloatArray, NDArray[np.intp]]:
        inputs = element.findall("input")
        vertex_input = next((candidate for candidate in inputs if candidate.attrib.get("semantic") == "VERTEX"), None)
        if vertex_input is None:
            raise ValueError(f"its <{element.tag}> refers to no vertices")
        # All inputs of a primitive share one list of indices: each corner takes `width` numbers, one for every offset.
        offsets = [int(_parse_integers(entry.attrib.get("offset", "0"))[0]) for entry in inputs]
        width, offset = max(offsets) + 1, offsets[inputs.index(vertex_input)]
        if not 0 <= offset < width <= len(inputs) + 16:
            raise ValueError(f"its <{element.tag}> has an input with the offset {max(offsets)}")
        points = self._read_positions(vertex_input)
        lists = [_parse_integers(index_list.text or "")[offset::width] for index_list in element.findall("p")]
        triangles = _split_into_triangles(element, lists)
        if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(points)):
            raise ValueError(
                f"its <{element.tag}> refers to vertex {int(triangles.max())}, but there are {len(points)}"
            )
        return points, triangles

    def _read_positions(self, vertex_input: Element) -> FloatArray:
        vertices = self._resolve_reference(vertex_input, "source", "vertices")
        position = next((candidate for candidate in vertices if candidate.attrib.get("semantic") == "POSITION"), None)
        if position is None:
            raise ValueError("its vertices have no positions")
        source = self._resolve_reference(position, "source", "source")
        accessor, array = source.find("technique_common/accessor"), source.find("float_array")
        if array is None:
            raise ValueError("its vertices have no numbers")
        numbers = _parse_floats(array.text or "")
        named = {} if accessor is None else accessor.attrib
        stride, first = (
            int(_parse_integers(named.get(key, usual))[0]) for key, usual in (("stride", "3"), ("offset", "0"))
        )
        if not (3 <= stride <= 64 and 0 <= first <= len(numbers)):
            raise ValueError(f"its vertices have a stride of {stride} numbers")
        count = (len(numbers) - first) // stride
        return numbers[first : first + count * stride].reshape(count, stride)[:, :3]

    def _resolve_reference(self, element: Element, attribute: str, tag: str) -> Element:
        """Return the element of this file that another element refers to by its id."""
        name = element.attrib.get(attribute, "")
        target = self._named.get(name[1:]) if name.startswith("#") else None
        if target is None or target.tag != tag:
            raise ValueError(f"it refers to {name[:80]!a}, but has no <{tag}> of that name")
        return target


def _split_into_triangles(element: Element, lists: list[NDArray[np.intp]]) -> NDArray[np.intp]:
    """Return the triangles (k, 3) of the corners that the <p> elements of a primitive list."""
    empty = np.empty((0, 3), dtype=np.intp)
    if element.tag == "triangles":
        return np.concatenate([empty, *(indices[: len(indices) // 3 * 3].reshape(-1, 3) for indices in lists)])
    if element.tag == "polylist":
        counts = _parse_integers(element.findtext("vcount") or "")
        corners = np.concatenate([np.empty(0, np.intp), *lists])
        if len(counts) and (counts.min() < 0 or counts.max() > len(corners) or counts.sum() != len(corners)):
            raise ValueError("the number of vertices of its <polylist> does not match its <vcount>")
        lists = np.split(corners, np.cumsum(counts)[:-1]) if len(counts) else []
    if element.tag == "tristrips":
        strips = [np.column_stack([strip[:-2], strip[1:-1], strip[2:]]) for strip in lists if len(strip) > 2]
        # Every second triangle of a strip runs the other way round; turn it, so that all normals agree.
        for strip in strips:
            strip[1::2] = strip[1::2, ::-1]
        return np.concatenate([empty, *strips])
    fans = [np.column_stack([np.full(len(fan) - 2, fan[0]), fan[1:-1], fan[2:]]) for fan in lists if len(fan) > 2]
    return np.concatenate([empty, *fans])


def _read_transform(element: Element) -> FloatArray:
    """Return the transform (4, 4) of a <matrix>, <translate>, <rotate> or <scale>; of others the identity."""
    transform = np.eye(4)
    sizes = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}
    if element.tag not in sizes:
        return transform
    values = _parse_floats(element.text or "")
    if len(values) != sizes[element.tag]:
        raise ValueError(f"its <{element.tag}> has {len(values)} numbers")
    if element.tag == "matrix":
        return values.reshape(4, 4)
    if element.tag == "translate":
        transform[:3, 3] = values
    elif element.tag == "scale":
        transform[:3, :3] = np.diag(values)
    else:
        # Rodrigues' formula. An axis of length zero gives the identity, not a division by zero.
        axis, angle = values[:3] / max(float(np.linalg.norm(values[:3])), 1e-300), np.radians(values[3])
        cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        transform[:3, :3] += np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
    return transform


def _parse_floats(text: str) -> FloatArray:
    try:
        return np.array(text.split(), dtype=np.str_).astype(np.float64)
    except ValueError:
        raise ValueError(f"it has {text.strip()[:40]!a}, where numbers are expected") from None


def _parse_integers(text: str) -> NDArray[np.intp]:
    try:
        return np.array(text.split(), dtype=np.str_).astype(np.intp)
    except (ValueError, OverflowError):
        raise ValueError(f"it has {text.strip()[:40]!a}, where whole numbers are expected") from None
