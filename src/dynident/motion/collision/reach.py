"""Reach of a motion: how far it takes the arm, for notes where no surroundings were stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.motion.collision.surroundings import Surroundings
from dynident.robot import Robot
from dynident.robot.kinematics import joint_frames

NOTHING_STATED = "NOTHING AROUND THE ROBOT IS CHECKED"
FLOOR_ALONE = "NOTHING BUT A FLOOR THROUGH THE BASE IS CHECKED"
"""How the notes begin that say so."""
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
) -> tuple[str, ...]:
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
    tuple of str
        One note, or none.
    """
    if surroundings.has_obstacles or surroundings.tool_range is not None:
        return ()
    reach = measure_reach(robot, t, q)
    height = f"{abs(reach.lowest):.2f} m {'below' if reach.lowest < 0 else 'above'} the base plane"
    below = f", below that plane for {reach.below:.0%} of the time" if reach.below else ""
    heading = FLOOR_ALONE if floor_assumed else NOTHING_STATED
    return (
        f"{heading}: no floor, wall or box was stated (surroundings). Lowest comes {reach.lowest_joint}, "
        f"{height} at {reach.lowest_time:.1f} s{below}; widest {reach.widest_joint}, {reach.widest:.2f} m from the "
        "base's axis; links and tool reach further. See that this is free, and run it at a third of the speed first.",
    )
