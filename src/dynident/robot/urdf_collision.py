"""Read the <collision> elements of a URDF as shapes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from dynident.arrays import FloatArray
from dynident.robot.mesh_files import find_mesh_file, list_candidate_files
from dynident.robot.meshes import build_hulls, read_surface
from dynident.robot.shapes import Block, Capsule, Cylinder, Shape
from dynident.robot.surfaces import Surface
from dynident.robot.urdf_xml import make_urdf_error
from dynident.robot.xml_text import Element

_SHAPES = ("box", "cylinder", "sphere", "capsule")


@dataclass(frozen=True, eq=False)
class LinkShapes:
    """Convex shapes of a link for collision checks, and the surfaces of its meshes as they are."""

    shapes: tuple[Shape, ...]
    surfaces: tuple[Surface, ...] = ()


class CollisionReader:
    """Reader of the shapes of links.

    Parameters
    ----------
    mesh_folders : sequence of Path
        Where the files of meshes are looked for.
    unread : list of str
        Receives a text on each mesh that cannot be read.

    Attributes
    ----------
    found : int
        Number of meshes whose file exists.
    """

    def __init__(self, mesh_folders: Sequence[Path], unread: list[str]) -> None:
        self._folders = tuple(mesh_folders)
        self._unread = unread
        self.found = 0

    def read_link(self, link: Element, placement: FloatArray) -> LinkShapes:
        """Return the shapes of a link in the frame that `placement` (4, 4) takes the link's coordinates to.

        Raises
        ------
        DynidentError
            For a shape without its sizes, or with sizes that are not positive numbers (line, link).
        """
        owner = f"link '{link.attributes['name']}'"
        shapes: list[Shape] = []
        surfaces: list[Surface] = []
        for collision in link.iter_children("collision"):
            geometry = collision.find_child("geometry")
            for element in [] if geometry is None else geometry.children:
                placed = placement @ read_origin(collision, owner)
                if element.tag == "mesh":
                    surface = self._read_mesh(element, placed, owner)
                    shapes.extend(() if surface is None else build_hulls(surface))
                    surfaces.extend(() if surface is None else [surface])
                elif element.tag in _SHAPES:
                    shapes.extend(self._read_shapes(element, placed, owner))
        return LinkShapes(tuple(shapes), tuple(surfaces))

    def _read_shapes(self, element: Element, placement: FloatArray, owner: str) -> Sequence[Shape]:
        if element.tag == "box":
            return [Block(placement, _read_sizes(element, "size", owner, 3))]
        radius = float(_read_sizes(element, "radius", owner, 1)[0])
        if element.tag == "sphere":
            return [Capsule(placement[:3, 3], placement[:3, 3], radius)]
        length = float(_read_sizes(element, "length", owner, 1)[0])
        if element.tag == "cylinder":
            return [Cylinder(placement, radius, length)]
        half = 0.5 * length * placement[:3, 2]
        return [Capsule(placement[:3, 3] - half, placement[:3, 3] + half, radius)]

    def _read_mesh(self, element: Element, placement: FloatArray, owner: str) -> Surface | None:
        uri = element.attributes.get("filename", "")
        scale = _read_numbers(element, "scale", owner, 3) if "scale" in element.attributes else np.ones(3)
        file = find_mesh_file(uri, self._folders)
        if file is None:
            sought = ", ".join(map(str, list_candidate_files(uri, self._folders)))
            why = f"not found; sought {sought}" if sought else "not found"
            self._unread.append(f"{uri or 'a mesh without a filename'} of {owner} ({why})")
            return None
        self.found += 1
        try:
            return read_surface(file, scale, placement)
        except ValueError as error:
            self._unread.append(f"{uri} of {owner} ({error})")
            return None


def list_mesh_names(root: Element) -> dict[str, tuple[str, ...]]:
    """Return the names of the meshes in <collision> elements of a URDF, in its order, each with its links."""
    links_of_mesh: dict[str, tuple[str, ...]] = {}
    for link in root.iter_children("link"):
        for collision in link.iter_children("collision"):
            geometry = collision.find_child("geometry")
            for element in [] if geometry is None else geometry.children:
                uri = element.attributes.get("filename", "") if element.tag == "mesh" else ""
                if uri:
                    links_of_mesh[uri] = tuple(dict.fromkeys((*links_of_mesh.get(uri, ()), link.attributes["name"])))
    return links_of_mesh


def read_origin(element: Element, owner: str) -> FloatArray:
    """Return the placement (4, 4) in the <origin> of an element; the identity without one."""
    placement = np.eye(4)
    origin = element.find_child("origin")
    if origin is None:
        return placement
    if "xyz" in origin.attributes:
        placement[:3, 3] = _read_numbers(origin, "xyz", owner, 3)
    if "quat_xyzw" in origin.attributes:
        placement[:3, :3] = Rotation.from_quat(_read_numbers(origin, "quat_xyzw", owner, 4)).as_matrix()
    elif "rpy" in origin.attributes:
        placement[:3, :3] = Rotation.from_euler("xyz", _read_numbers(origin, "rpy", owner, 3)).as_matrix()
    return placement


def _read_sizes(element: Element, attribute: str, owner: str, count: int) -> FloatArray:
    values = _read_numbers(element, attribute, owner, count)
    if not (values > 0).all():
        raise make_urdf_error(
            f'{attribute}="{element.attributes[attribute]}" of the <{element.tag}> in the <collision> of {owner}; '
            "expected positive lengths in m.",
            element.line,
            "",
        )
    return values


def _read_numbers(element: Element, attribute: str, owner: str, count: int) -> FloatArray:
    written = element.attributes.get(attribute, "")
    try:
        values = [float(word) for word in written.split()]
    except ValueError:
        values = []
    if len(values) != count or not all(map(math.isfinite, values)):
        expected = "a number" if count == 1 else f"{count} numbers"
        raise make_urdf_error(
            f'{attribute}="{written}" of the <{element.tag}> in the <collision> of {owner}; expected {expected}.',
            element.line,
            "",
        )
    return np.array(values)
