"""Turn stated surroundings into shapes and half-spaces, check them, assume a floor; the ground under standing feet.

Holds when a floor is assumed, and the notes on what is not checked.

Where no surroundings were stated, the reach of a motion says how far it takes the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import scipy

from dynident.array_types import FloatArray, IntArray
from dynident.errors import DynidentError, Note, Remedy, describe_missing_joint
from dynident.motion.collision.surroundings import Box, Standing, Surroundings, ToolRange, Wall
from dynident.number_format import format_percent
from dynident.robot.collision_reader import collision_geometry
from dynident.robot.collision_shapes import Block, Capsule, Shape
from dynident.robot.contacts import find_contact_link, find_upwards, locate_contact, parse_contact
from dynident.robot.forward_kinematics import joint_frames
from dynident.robot.joint import Contact
from dynident.robot.json_fields import make_pointer
from dynident.robot.robot_model import Robot

NOTHING_STATED, FLOOR_ALONE = "surroundings_unchecked", "floor_alone_checked"
"""Codes of the notes that say that nothing around the robot is checked, or nothing but an assumed floor."""
_HEADINGS = {
    NOTHING_STATED: "NOTHING AROUND THE ROBOT IS CHECKED",
    FLOOR_ALONE: "NOTHING BUT A FLOOR THROUGH THE BASE IS CHECKED",
}
_BELOW = 1e-3
"""Distance below the base plane that is rounding, m."""


@dataclass(frozen=True)
class Reach:
    """How far the joints of an arm go from its base.

    Parameters
    ----------
    lowest : float
        Height of the lowest joint's origin over the plane z = 0 of the base frame, m.
    lowest_joint : str
        Name of that joint.
    lowest_time : float
        Time at which it is there, s.
    below : float
        Share of the time in which some joint's origin is below that plane.
    widest : float
        Distance of the farthest joint's origin from the base frame's z axis, m.
    widest_joint : str
        Name of that joint.
    """

    lowest: float
    lowest_joint: str
    lowest_time: float
    below: float
    widest: float
    widest_joint: str


def measure_reach(robot: Robot, t: FloatArray, q: FloatArray) -> Reach:
    """Measure how far a motion takes the origins of the joints.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    t : (m,)
        Times, s.
    q : (m, n)
        Positions, rad or m.

    Returns
    -------
    Reach
        Extremes of the motion, and where and when they occur.
    """
    origins = joint_frames(robot, q)[:, :, :3, 3]
    heights, widths = origins[:, :, 2], np.hypot(origins[:, :, 0], origins[:, :, 1])
    moment, low = np.unravel_index(int(heights.argmin()), heights.shape)
    wide = int(widths.max(axis=0).argmax())
    names = robot.tree.joint_names
    return Reach(
        lowest=float(heights[moment, low]),
        lowest_joint=names[int(low)],
        lowest_time=float(t[moment]),
        below=float((heights.min(axis=1) < -_BELOW).mean()),
        widest=float(widths[:, wide].max()),
        widest_joint=names[wide],
    )


def note_reach(
    robot: Robot, t: FloatArray, q: FloatArray, surroundings: Surroundings, *, floor_assumed: bool = False
) -> tuple[Note, ...]:
    """Return notes on the reach of a motion where no obstacle was stated; none otherwise.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    t, q : (m,), (m, n)
        Times, s, and positions, rad or m.
    surroundings : Surroundings
        The surroundings as a request states them.
    floor_assumed : bool
        Whether a floor was assumed.

    Returns
    -------
    tuple of Note
        One note, or none.
    """
    if surroundings.has_obstacles or surroundings.tool_range is not None:
        return ()
    reach = measure_reach(robot, t, q)
    height = f"{abs(reach.lowest):.2f} m {'below' if reach.lowest < 0 else 'above'} the base plane"
    below = f", below that plane for {format_percent(reach.below, decimals=0)} of the time" if reach.below else ""
    code = FLOOR_ALONE if floor_assumed else NOTHING_STATED
    note = (
        f"{_HEADINGS[code]}: no floor, wall or box was stated (surroundings). The lowest joint is "
        f"{reach.lowest_joint}, {height} at {reach.lowest_time:.1f} s{below}. The joint farthest from the base's axis "
        f"is {reach.widest_joint}, at {reach.widest:.2f} m. Links and tool reach further. Make sure that this space is "
        "free, and run the motion at a third of the speed first."
    )
    return (Note(note, code=code),)


ASSUMED_HEIGHT = 0.0
"""Height of an assumed floor in the base frame, m: robots stand on their base."""
_NO_FLOOR = Remedy("assume_floor", False)
FLOOR_ASSUMED = Note(
    "A floor through the base (z = 0) is assumed, because no surroundings were stated: only the first link may "
    f"reach it. State the surroundings, or that there is no floor: {_NO_FLOOR}.",
    (_NO_FLOOR,),
)
_UPRIGHT = 0.99
"""Cosine of the largest angle, 8°, between gravity and the base's z axis of a robot that stands on a floor."""
_HANGS = 0.1
"""Share of the reach: a robot that rests lower than this below its base, as a leg does, stands on no floor there."""
_POSTURES, _USABLE_SHARE = 200, 0.02
"""Of so many postures within the limits this share must be above the floor, or the robot works below its base."""
_RADIUS = 0.06
"""Radius of the links of usual arms as a share of the reach (UR10e 0.05, Panda 0.08, SO-101 0.06)."""


def assume_floor(
    robot: Robot, surroundings: Surroundings, low: FloatArray, high: FloatArray
) -> tuple[Surroundings, float | None]:
    """Add the floor that a robot stands on to empty surroundings, if it seems to stand on one.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    surroundings : Surroundings
        The surroundings as a request states them.
    low, high : (n,)
        Position limits, rad or m.

    Returns
    -------
    surroundings : Surroundings
        With the floor, or as they are.
    link_radius : float or None
        Radius (m) of links without collision geometry above the floor; `None` where none is assumed.
    """
    if not surroundings.assume_floor or surroundings.has_obstacles or surroundings.tool_range is not None:
        return surroundings, None
    weight = float(np.linalg.norm(robot.gravity))
    # Without gravity, or hanging from a wall or ceiling, a robot has no floor at its base.
    if weight == 0.0 or -robot.gravity[2] < _UPRIGHT * weight:
        return surroundings, None
    # At zero and in the middle of the ranges, the two usual homes: an arm that stands on a floor is above it in one of
    # them.
    rests = np.stack([np.clip(0.0, low, high), 0.5 * (low + high)])
    origins = joint_frames(robot, rests)[:, :, :3, 3]
    reach = float(np.linalg.norm(origins, axis=2).max())
    if not np.isfinite(reach) or origins[:, :, 2].min(axis=1).max() < -_HANGS * reach:
        return surroundings, None
    postures = np.random.default_rng(0).uniform(low, high, (_POSTURES, robot.n))
    heights = joint_frames(robot, postures)[:, :, 2, 3]
    # Joints that never change their height belong to the pedestal, which stands on the floor anyway.
    moving = np.ptp(heights, axis=0) > 1e-6
    if (heights[:, moving] >= _RADIUS * reach).all(axis=1).mean() < _USABLE_SHARE:
        return surroundings, None
    return replace(surroundings, floor=ASSUMED_HEIGHT), _RADIUS * reach


__all__ = [
    "Box",
    "HalfSpace",
    "Surroundings",
    "ToolRange",
    "Wall",
    "build_block",
    "check_surroundings",
    "list_half_spaces",
]

_AT = "/surroundings"
_SHORTEST = 1e-9
"""Shortest valid normal: the direction of a shorter one is rounding."""


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The free side of a plane: normal · x ≥ offset.

    Parameters
    ----------
    name : str
        Name for messages.
    normal : (3,)
        Unit normal in the base frame, to the free side.
    offset : float
        Smallest value of normal · x on the free side, m.
    """

    name: str
    normal: FloatArray
    offset: float


def build_block(box: Box) -> Block:
    """Return a box as a shape in the base frame."""
    placement = np.eye(4)
    placement[:3, :3] = scipy.spatial.transform.Rotation.from_euler("xyz", box.rpy).as_matrix()
    placement[:3, 3] = box.center
    return Block(placement, np.array(box.size, dtype=float))


def list_half_spaces(surroundings: Surroundings) -> tuple[HalfSpace, ...]:
    """Return floor and walls as half-spaces."""
    half_spaces = (
        [] if surroundings.floor is None else [HalfSpace("floor", np.array([0.0, 0.0, 1.0]), surroundings.floor)]
    )
    for wall in surroundings.walls:
        normal = np.array(wall.normal) / np.linalg.norm(wall.normal)
        half_spaces.append(HalfSpace(f"wall '{wall.name}'", normal, float(normal @ np.array(wall.point))))
    return tuple(half_spaces)


def check_surroundings(surroundings: Surroundings, joint_names: Sequence[str] | None = None) -> None:
    """Raise `DynidentError` for an invalid obstacle, range or distance.

    Parameters
    ----------
    surroundings : Surroundings
        The surroundings as a request states them.
    joint_names : sequence of str, optional
        Names that the joint of the tool must be among.
    """
    for index, wall in enumerate(surroundings.walls):
        at = make_pointer(index, within=f"{_AT}/walls")
        if np.linalg.norm(wall.normal) < _SHORTEST:
            raise DynidentError(
                f"the normal of wall '{wall.name}' is zero; it must point to the free side",
                pointer=f"{at}/normal",
            )
    if surroundings.tool_range is not None:
        _check_tool(surroundings.tool_range, joint_names)


def _check_tool(tool: ToolRange, joint_names: Sequence[str] | None) -> None:
    at = f"{_AT}/tool_range"
    for axis, low, high in zip("xyz", tool.low, tool.high, strict=True):
        if low is not None and high is not None and low >= high:
            raise DynidentError(
                f"the tool's range in {axis} is from {low:g} to {high:g}; give the lower end first", pointer=at
            )
    if tool.joint is not None and joint_names is not None and tool.joint not in joint_names:
        raise DynidentError(
            describe_missing_joint(tool.joint, joint_names),
            pointer=f"{at}/joint",
            title="Unknown joint",
        )


NOT_STANDING = "The robot does not stand"
_FEET = "/standing/feet"
_NARROW = 0.01
"""Smallest width (m) of the support: less is a line, on which nothing balances."""
_FLAT = 0.005
"""Largest distance (m) of a standing point from the plane of the ground: soles give way by some millimetres."""
_CORNERS, _LINE = 8, 1e-6
"""Most points of a sole that are kept, so that a fine mesh costs nothing; width (m) of points on a line."""


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground under feet that stand, in the base frame.

    Parameters
    ----------
    links : (p,)
        For each point that touches it, the joint of the tree that carries the point.
    points : (p, 3)
        These points, m: at most the corners of each sole.
    centre : (3,)
        Mean of all points that touch it, m.
    axes : (3, 3)
        Its axes as columns: two along the ground, the third upwards.
    """

    links: tuple[int, ...]
    points: FloatArray
    centre: FloatArray
    axes: FloatArray

    @cached_property
    def places(self) -> FloatArray:
        """The points (p, 2) along the ground, from its centre, m."""
        return np.asarray((self.points - self.centre) @ self.axes[:, :2])

    @cached_property
    def transform(self) -> FloatArray:
        """The matrix (6, 6) from a wrench about the base's origin to one about the centre, along the ground's axes."""
        lever = _cross_matrix(self.centre)
        turn = self.axes.T
        return np.block([[turn, np.zeros((3, 3))], [-turn @ lever, turn]])

    @cached_property
    def forces_to_wrench(self) -> FloatArray:
        """The matrix G (6, 3 p) from forces at the points to their wrench about the base's origin."""
        return np.hstack([np.vstack([np.eye(3), _cross_matrix(point)]) for point in self.points])


def _cross_matrix(v: FloatArray) -> FloatArray:
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def fit_ground(robot: Robot, standing: Standing, home: FloatArray, mesh_folders: Sequence[Path] = ()) -> Ground:
    """Return the ground under feet that stand: the plane through their points, with the corners of each sole.

    Parameters
    ----------
    robot : Robot
        The robot on a fixed base.
    standing : Standing
        The feet.
    home : (n,)
        Posture in which it stands, rad or m.
    mesh_folders : sequence of Path
        Where the meshes of soles are looked for.

    Raises
    ------
    DynidentError
        For feet that are no links, or whose points are not known; or are not on one plane, or on a line.
    """
    up = find_upwards(robot)
    # Of a ball, which point touches depends on the normal, which depends on the points: the second round has both.
    for _ in range(2):
        ground = _fit_plane(_locate_feet(robot, standing, home, up, mesh_folders), standing, up)
        up = ground.axes[:, 2]
    soles = [np.flatnonzero(np.array(ground.links) == link) for link in dict.fromkeys(ground.links)]
    corners = np.concatenate([sole[_find_corners(ground.places[sole])] for sole in soles])
    return replace(ground, links=tuple(ground.links[k] for k in corners), points=ground.points[corners])


def _find_corners(places: FloatArray) -> IntArray:
    """Return which of points (p, 2) of a sole are farthest in some direction, in units of its length and width.

    No two edges of a rectangle are then less than 45° apart, so that each of its corners is one of these points.
    """
    angles = 2.0 * np.pi * (np.arange(_CORNERS) + 0.5) / _CORNERS
    scaled = places / np.maximum(np.ptp(places, axis=0), _LINE)
    return np.unique((scaled @ np.stack([np.cos(angles), np.sin(angles)])).argmax(axis=0))


def _locate_feet(
    robot: Robot, standing: Standing, home: FloatArray, up: FloatArray, folders: Sequence[Path]
) -> list[tuple[int, FloatArray]]:
    """Return for each foot the joint of the tree that carries it, and its points (p, 3) that touch the ground."""
    frames, feet = joint_frames(robot, home[None]), []
    for index, text in enumerate(standing.feet):
        pointer = f"{_FEET}/{index}"
        contact = parse_contact(text, pointer)
        if contact.lift is not None:
            raise DynidentError(
                f"The foot {text} has a height behind a ^, but a foot that stands is not lifted; leave ^ and height "
                "out, or let the foot not stand.",
                pointer=pointer,
                title=NOT_STANDING,
            )
        link = find_contact_link(robot, contact, pointer)
        if contact.point is not None:
            feet.append((link, locate_contact(robot, contact, frames) - contact.radius * up))
            continue
        frame = frames[0, link]
        points = _find_sole(robot, contact, link, folders, pointer)
        feet.append((link, points @ frame[:3, :3].T + frame[:3, 3]))
    return feet


def _find_sole(robot: Robot, contact: Contact, link: int, folders: Sequence[Path], pointer: str) -> FloatArray:
    """Return the points (p, 3) of a link's shapes, in its frame, that are lowest with all joints at zero.

    Who describes a robot draws it at zero, where it stands with its base upright, whichever way gravity then points.
    """
    geometry = collision_geometry(robot, mesh_folders=folders)
    shapes = [shape for body in geometry.bodies if body.joint == link for shape in body.shapes]
    if not shapes:
        raise DynidentError(
            f"The foot {contact.link} has no collision geometry that could be read; give the points of it that touch "
            f"the ground, such as {contact.link}@0.1,0.03,-0.05 (m, in the frame of the link).",
            pointer=pointer,
            title="Unknown sole",
        )
    up = joint_frames(robot, np.zeros((1, robot.n)))[0, link, 2, :3]
    points = np.concatenate([_list_lowest_points(shape, up) for shape in shapes])
    heights = points @ up
    return np.asarray(points[heights <= heights.min() + _FLAT])


def _list_lowest_points(shape: Shape, up: FloatArray) -> FloatArray:
    if isinstance(shape, Capsule):
        return np.stack([shape.start, shape.end]) - shape.radius * up
    return shape.corners


def _fit_plane(feet: Sequence[tuple[int, FloatArray]], standing: Standing, up: FloatArray) -> Ground:
    """Return the plane through the points of feet; raise where they are not on one, or on a line."""
    links = tuple(link for link, points in feet for _ in points)
    points = np.concatenate([points for _, points in feet])
    names = [text for text, (_, own) in zip(standing.feet, feet, strict=True) for _ in own]
    centre = points.mean(axis=0)
    # The direction in which the points spread least is the normal of the plane.
    sizes, directions = np.linalg.svd(points - centre, full_matrices=len(points) < 3)[1:]
    if len(points) < 3 or np.ptp((points - centre) @ directions[1]) < _NARROW or sizes[0] == 0.0:
        raise DynidentError(
            f"The points of the feet that touch the ground ({len(points)}) are on a line, on which the robot cannot "
            "balance; name more feet, or more points of them.",
            pointer=_FEET,
            title=NOT_STANDING,
        )
    normal = directions[2] if directions[2] @ up > 0 else -directions[2]
    heights = (points - centre) @ normal
    worst = int(np.abs(heights).argmax())
    if abs(heights[worst]) > _FLAT:
        raise DynidentError(
            f"At home, the feet are not on one plane: a point of {names[worst]} is {abs(heights[worst]):.3g} m "
            f"{'above' if heights[worst] > 0 else 'below'} the plane through all. Choose a home posture in which they "
            "are, or other feet.",
            pointer="/home",
            title=NOT_STANDING,
        )
    return Ground(links, points, centre, np.column_stack([directions[0], np.cross(normal, directions[0]), normal]))
