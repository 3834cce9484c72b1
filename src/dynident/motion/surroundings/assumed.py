"""Floor that is assumed where no surroundings are stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.motion.surroundings.stated import Surroundings
from dynident.robot.kinematics import joint_frames
from dynident.robot.model import Robot

FLOOR_ASSUMED = (
    "A floor through the base (z = 0) is assumed, since nothing around the robot was stated: no link but the first may "
    "reach it. State what is there (surroundings), or that there is no floor (assume_floor: false, --no-floor)."
)
_UPRIGHT = 0.99
"""Cosine of the largest angle, 8°, between gravity and the base's z axis of a robot that stands on a floor."""
_HANGS = 0.1
"""Share of the reach: a robot that rests lower than this below its base, as a leg does, stands on no floor there."""
_POSTURES, _ROOM = 200, 0.02
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
    surroundings : Surroundings
    low, high : (n,)
        Position limits.

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
    if weight == 0.0 or -robot.gravity[2] < _UPRIGHT * weight:
        return surroundings, None
    rests = np.stack([np.clip(0.0, low, high), 0.5 * (low + high)])
    origins = joint_frames(robot, rests)[:, :, :3, 3]
    reach = float(np.linalg.norm(origins, axis=2).max())
    if not np.isfinite(reach) or origins[:, :, 2].min(axis=1).max() < -_HANGS * reach:
        return surroundings, None
    postures = np.random.default_rng(0).uniform(low, high, (_POSTURES, robot.n))
    heights = joint_frames(robot, postures)[:, :, 2, 3]
    # Joints that never change their height belong to the pedestal, which stands on the floor anyway.
    moving = np.ptp(heights, axis=0) > 1e-6
    if (heights[:, moving] >= _RADIUS * reach).all(axis=1).mean() < _ROOM:
        return surroundings, None
    return replace(surroundings, floor=0.0), _RADIUS * reach
