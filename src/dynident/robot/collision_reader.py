"""Read collision geometry of a URDF or MJCF: shapes and meshes in the frames of joints; what is left unchecked."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy

from dynident.array_types import FloatArray
from dynident.errors import DynidentError, Note, Remedy
from dynident.robot.collision_shapes import Block, Capsule, Cylinder, Shape
from dynident.robot.forward_kinematics import joint_motion
from dynident.robot.joint import Joint, JointKind
from dynident.robot.json_fields import join_names, parse_json
from dynident.robot.link_meshes import (
    Surface,
    build_hulls,
    find_mesh_file,
    list_candidate_files,
    list_package_folders,
    read_surface,
)
from dynident.robot.modified_dh import TITLE, read_capsules_and_rows
from dynident.robot.robot_model import Robot
from dynident.robot.urdf_reader import make_urdf_error, parse_urdf
from dynident.robot.xml_text import Element

_SHAPES = ("box", "cylinder", "sphere", "capsule")


@dataclass(frozen=True, eq=False)
class LinkShapes:
    """Shapes of a link in one frame.

    Parameters
    ----------
    shapes : tuple of Shape
        Convex shapes for collision checks.
    surfaces : tuple of Surface
        The surfaces of its meshes as they are.
    """

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
        # The length of a capsule is that between the centres of its round ends.
        half = 0.5 * length * placement[:3, 2]
        return [Capsule(placement[:3, 3] - half, placement[:3, 3] + half, radius)]

    def _read_mesh(self, element: Element, placement: FloatArray, owner: str) -> Surface | None:
        uri = element.attributes.get("filename", "")
        scale = _read_numbers(element, "scale", owner, 3) if "scale" in element.attributes else np.ones(3)
        file = find_mesh_file(uri, self._folders)
        if file is None:
            sought = ", ".join(map(str, list_candidate_files(uri, self._folders)))
            why = f"not found; the search was for {sought}" if sought else "not found"
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
        placement[:3, :3] = scipy.spatial.transform.Rotation.from_quat(
            _read_numbers(origin, "quat_xyzw", owner, 4)
        ).as_matrix()
    # Roll, pitch and yaw turn about fixed axes, x first: what SciPy writes in lower case.
    elif "rpy" in origin.attributes:
        placement[:3, :3] = scipy.spatial.transform.Rotation.from_euler(
            "xyz", _read_numbers(origin, "rpy", owner, 3)
        ).as_matrix()
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


BASE = -1
"""Index that stands for the base, which no joint moves."""
UNCHECKED = "collision_unchecked"
"""Code of the note on links whose shapes could not be read."""
_SHOWN = 3
"""Number of unreadable meshes that a note names; the reason is mostly the same for all."""


@dataclass(frozen=True, eq=False)
class Body:
    """Everything that moves with one joint, as shapes in that joint's frame.

    Parameters
    ----------
    name : str
        Name of the link.
    joint : int
        Index of the joint in the robot's tree; `BASE` for the base.
    shapes : tuple of Shape
        Convex shapes; a mesh is cut into convex pieces.
    surfaces : tuple of Surface
        The meshes as they are.
    """

    name: str
    joint: int
    shapes: tuple[Shape, ...]
    surfaces: tuple[Surface, ...] = ()


@dataclass(frozen=True, eq=False)
class CollisionGeometry:
    """Collision geometry of a robot.

    Parameters
    ----------
    bodies : tuple of Body
        Bodies that have shapes, the base first.
    bare : tuple of str
        Names of moving bodies without any shape.
    notes : tuple of str
        What could not be read, or stands for missing geometry, in sentences.
    """

    bodies: tuple[Body, ...]
    bare: tuple[str, ...]
    notes: tuple[str, ...]


def collision_geometry(
    robot: Robot, *, mesh_folders: Sequence[Path] = (), link_radius: float | None = None
) -> CollisionGeometry:
    """Return the collision geometry of a robot's description, in the frames of the joints of the robot's tree.

    In a URDF it is in <collision>: boxes, cylinders, spheres, capsules, and meshes, of which the convex hulls of a few
    slices count. In a modified Denavit-Hartenberg table it is in `capsules`. The shapes of an MJCF are not read.

    Parameters
    ----------
    robot : Robot
        The robot, with the description that it was read from.
    mesh_folders : sequence of Path
        Where the files of meshes are looked for.
    link_radius : float, optional
        Links without geometry become capsules of this radius (m) from their joint's origin to those of the next.

    Returns
    -------
    CollisionGeometry
        Bodies with their shapes, and what could not be read.

    Raises
    ------
    DynidentError
        A shape in the description is not one (line, link); or folders are named, and none holds any of the meshes.
    """
    robot = robot.tree
    shapes: dict[int, list[Shape]] = {index: [] for index in range(BASE, robot.n)}
    surfaces: dict[int, list[Surface]] = {index: [] for index in range(BASE, robot.n)}
    names = {BASE: "base"}
    unread: list[str] = []
    for link, joint, parts in _iter_links(robot, mesh_folders, unread):
        # The base is called by the first link of it that has a shape: links such as `world` have none.
        if joint == BASE and link and parts.shapes and not shapes[BASE]:
            names[BASE] = link
        shapes[joint].extend(parts.shapes)
        surfaces[joint].extend(parts.surfaces)
    names |= {index: joint.link or joint.name for index, joint in enumerate(robot.joints)}
    notes: list[str] = [_describe_unread_meshes(unread, mesh_folders)] if unread else []
    # Between the world and the root link of a base that moves there are no links.
    first = robot.n_massless
    bare = [index for index in range(first, robot.n) if not shapes[index]]
    if link_radius is not None and bare:
        for index in [joint for joint in (BASE, *range(first, robot.n)) if not shapes[joint]]:
            shapes[index].extend(_connect_origins(robot, index, link_radius))
        notes.append(
            f"Capsules of radius {link_radius:.3g} m between the joints' origins replace the missing collision bodies "
            f"of {join_names(names[index] for index in bare)}."
        )
        bare = []
    bodies = tuple(
        Body(names[index], index, tuple(body_shapes), tuple(surfaces[index]))
        for index, body_shapes in sorted(shapes.items())
        if body_shapes
    )
    return CollisionGeometry(bodies, tuple(names[index] for index in bare), tuple(notes))


def list_collision_meshes(robot: Robot) -> dict[str, tuple[str, ...]]:
    """Return the collision meshes that a robot's description names, in its order, each with the links that use it."""
    return list_mesh_names(parse_urdf(robot.description.content)) if robot.description.format == "urdf" else {}


def find_mesh_folders(robot: Robot, file: Path) -> tuple[Path, ...]:
    """Return the folders above a description's file, or of the ROS environment, that hold any collision mesh of it.

    Parameters
    ----------
    robot : Robot
        The robot, with the description that it was read from.
    file : Path
        The description's file.

    Returns
    -------
    tuple of Path
        Nearest first, none twice.
    """
    folders = list_package_folders(file)
    return tuple(
        dict.fromkeys(
            folder
            for uri in list_collision_meshes(robot)
            for folder in folders
            if find_mesh_file(uri, [folder]) is not None
        )
    )


def _iter_links(robot: Robot, mesh_folders: Sequence[Path], unread: list[str]) -> Iterator[tuple[str, int, LinkShapes]]:
    """Yield the name, joint and shapes of every link of a description; none for an MJCF."""
    if robot.description.format == "urdf":
        yield from _iter_urdf_links(robot, mesh_folders, unread)
    elif robot.description.format == "modified_dh":
        yield from _iter_table_links(robot)


def _iter_urdf_links(
    robot: Robot, mesh_folders: Sequence[Path], unread: list[str]
) -> Iterator[tuple[str, int, LinkShapes]]:
    root = parse_urdf(robot.description.content)
    reader = CollisionReader(mesh_folders, unread)
    places = _place_links(robot, root)
    for link in root.iter_children("link"):
        name = link.attributes["name"]
        joint, placement = places[name]
        yield name, joint, reader.read_link(link, placement)
    # Folders that hold none of the meshes are a mistake. Single meshes that are missing become a note.
    if mesh_folders and unread and not reader.found:
        raise DynidentError(
            f"none of the {len(unread)} collision meshes of the URDF is in {join_names(map(str, mesh_folders))}, so "
            f"collisions could not be checked. The first: {unread[0]}. Give the folder that contains the package of "
            "package://…, or the folder of a relative name.",
            pointer="/surroundings/mesh_folders",
            title="Collision meshes not found",
        )


def _describe_unread_meshes(unread: Sequence[str], mesh_folders: Sequence[Path]) -> Note:
    """Return a sentence on the meshes that could not be read and on what to do about it."""
    remedies = () if mesh_folders else (Remedy("meshes"),)
    cure = "".join(f" Give the meshes: {remedy}." for remedy in remedies)
    rest = f"; and {len(unread) - _SHOWN} more" if len(unread) > _SHOWN else ""
    text = f"mesh{'es' if len(unread) > 1 else ''} that could not be read: {'; '.join(unread[:_SHOWN])}{rest}.{cure}"
    return Note(f"COLLISION IS NOT CHECKED for {len(unread)} {text}", remedies, UNCHECKED)


def _place_links(robot: Robot, root: Element) -> dict[str, tuple[int, FloatArray]]:
    """Return for every link of a URDF the moving joint that carries it and its placement (4, 4) in its frame."""
    joints = list(root.iter_children("joint"))
    child_of = {joint.attributes["name"]: _get_link_name(joint, "child") for joint in joints}
    roots = {link.attributes["name"] for link in root.iter_children("link")} - set(child_of.values())
    # The last coordinate of a base that moves carries the root link; without any it is the base itself.
    places: dict[str, tuple[int, FloatArray]] = {name: (BASE + robot.n_base, np.eye(4)) for name in roots}
    # Joints of a URDF stand in any order. Those whose parent link has no place yet wait for the next round; the text
    # was checked to be a tree when the robot was read, so every round places at least one link.
    waiting = joints
    while waiting:
        later = []
        for joint in waiting:
            parent = places.get(_get_link_name(joint, "parent"))
            if parent is None:
                later.append(joint)
                continue
            name = joint.attributes["name"]
            if name in robot.joint_names:
                places[child_of[name]] = (robot.joint_names.index(name), np.eye(4))
            else:
                # Fixed and locked joints are not in the robot: their link belongs to the moving joint before.
                fixed = (
                    parent[1]
                    @ read_origin(joint, f"joint '{name}'")
                    @ _get_held_transform(joint, robot.locked_joints.get(name, 0.0))
                )
                places[child_of[name]] = (parent[0], fixed)
        waiting = later
    return places


def _get_held_transform(joint: Element, value: float) -> FloatArray:
    """Return the transform (4, 4) that a joint held at a position adds behind its placement."""
    if value == 0.0:
        return np.eye(4)
    axis_element = joint.find_child("axis")
    axis = np.array([1.0, 0.0, 0.0])  # the default of URDF
    if axis_element is not None:
        axis = np.array([float(word) for word in axis_element.attributes["xyz"].split()])
    kind: JointKind = "prismatic" if joint.attributes["type"] == "prismatic" else "revolute"
    held = Joint("", kind, BASE, np.eye(4), axis / np.linalg.norm(axis))
    moved: FloatArray = joint_motion(held, np.array([value]))[0]
    return moved


def _get_link_name(joint: Element, end: str) -> str:
    element = joint.find_child(end)
    return "" if element is None else element.attributes["link"]


def _iter_table_links(robot: Robot) -> Iterator[tuple[str, int, LinkShapes]]:
    base, rows = read_capsules_and_rows(parse_json(robot.description.content, "", TITLE))
    yield "", BASE, LinkShapes(base)
    places: list[tuple[int, FloatArray]] = []
    for row in rows:
        carrier, placement = places[row.antecedent] if row.antecedent >= 0 else (BASE, np.eye(4))
        if row.name in robot.joint_names:
            carrier, placement = robot.joint_names.index(row.name), np.eye(4)
        else:
            # Locked joints are not in the robot: their link belongs to the moving joint before.
            held = Joint(row.name, row.kind, BASE, row.placement, np.array([0.0, 0.0, 1.0]))
            value = np.array([robot.locked_joints.get(row.name, 0.0)])
            placement = placement @ row.placement @ joint_motion(held, value)[0]
        places.append((carrier, placement))
        yield row.link or row.name, carrier, LinkShapes(tuple(capsule.transform(placement) for capsule in row.capsules))


def _connect_origins(robot: Robot, joint: int, radius: float) -> list[Capsule]:
    origin = np.zeros(3)
    # A link that carries no other joint becomes a ball about its own joint's origin.
    ends = [other.placement[:3, 3] for other in robot.joints if other.parent == joint]
    return [Capsule(origin, end, radius) for end in ends or [origin]]
