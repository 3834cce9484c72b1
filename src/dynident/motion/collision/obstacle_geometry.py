"""Turn stated surroundings into shapes and half-spaces, check them, and assume a floor where none is stated.

Holds when a floor is assumed, and the notes on what is not checked.

Where no surroundings were stated, the reach of a motion says how far it takes the arm.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from dynident.array_types import FloatArray
from dynident.errors import DynidentError, Note, Remedy, describe_missing_joint
from dynident.motion.collision.surroundings import Box, Surroundings, ToolRange, Wall
from dynident.number_format import format_percent
from dynident.robot.collision_shapes import Block
from dynident.robot.forward_kinematics import joint_frames
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
