"""Clearance along a designed motion, body by body, for a picture of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dynident.array_types import FloatArray
from dynident.excitation.request import DesignRequest
from dynident.motion.collision.contacts import Nearest
from dynident.motion.limits.bounds import build_bounds
from dynident.robot.model import Robot


def find_nearest_along(
    robot: Robot, request: DesignRequest, q: FloatArray, mesh_folders: Sequence[Path] = ()
) -> tuple[Nearest, ...]:
    """Return for every body that a design keeps clear what it is nearest to at postures q.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    request : DesignRequest
        The design request, with its limits and surroundings.
    q : (m, n)
        Postures along the motion, rad or m.
    mesh_folders : sequence of Path
        Folders of the description's meshes.

    Returns
    -------
    tuple of Nearest
        For each body, what it is nearest to; empty where nothing is kept clear of.

    Raises
    ------
    DynidentError
        Where the request does not fit the robot.
    """
    around = replace(request.surroundings, mesh_folders=tuple(map(str, mesh_folders)))
    space = build_bounds(robot, request.limits, torque_margin=request.torque_margin, surroundings=around).space
    return () if space is None or space.contacts is None else tuple(space.contacts.find_nearest(q))
