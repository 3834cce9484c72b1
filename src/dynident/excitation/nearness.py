"""What every part of a robot is nearest to while a designed motion goes on: for a picture of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dynident.arrays import FloatArray
from dynident.excitation.request import DesignRequest
from dynident.motion.limits.bounds import bounds_of
from dynident.motion.surroundings.contacts import Nearest
from dynident.robot.model import Robot


def nearest_along(
    robot: Robot, request: DesignRequest, q: FloatArray, mesh_folders: Sequence[Path] = ()
) -> tuple[Nearest, ...]:
    """Of every body that a design keeps clear of anything, what it is nearest to at postures q (m, n).

    Raises
    ------
    DynidentError
        Where the request does not fit the robot.
    """
    around = replace(request.surroundings, mesh_folders=tuple(map(str, mesh_folders)))
    space = bounds_of(robot, request.limits, torque_margin=request.torque_margin, surroundings=around).space
    return () if space is None or space.contacts is None else tuple(space.contacts.nearest(q))
