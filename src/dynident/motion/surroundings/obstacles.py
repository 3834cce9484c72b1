"""Geometry of the stated surroundings: floor, walls, boxes and the tool's range, and their checks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dynident.arrays import FloatArray
from dynident.asking import check_ranges
from dynident.errors import DynidentError
from dynident.motion.surroundings.stated import Box, Surroundings, ToolRange, Wall
from dynident.robot.pointers import make_pointer
from dynident.robot.shapes import Block

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
    """The free side of a plane: normal · x ≥ offset (m, base frame), with a unit normal (3,)."""

    name: str
    normal: FloatArray
    offset: float


def build_block(box: Box) -> Block:
    """Return a box as a shape in the base frame."""
    placement = np.eye(4)
    placement[:3, :3] = Rotation.from_euler("xyz", box.rpy).as_matrix()
    placement[:3, 3] = box.center
    return Block(placement, np.array(box.size))


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
    joint_names : sequence of str, optional
        Names that the joint of the tool must be among.
    """
    check_ranges(surroundings, _AT)
    for index, wall in enumerate(surroundings.walls):
        at = make_pointer(index, within=f"{_AT}/walls")
        if np.linalg.norm(wall.normal) < _SHORTEST:
            raise DynidentError(
                f"the normal of wall '{wall.name}' is zero; it must point to the side that is free",
                pointer=f"{at}/normal",
            )
    if surroundings.tool_range is not None:
        _check_tool(surroundings.tool_range, joint_names)


def _check_tool(tool: ToolRange, joint_names: Sequence[str] | None) -> None:
    at = f"{_AT}/tool_range"
    for axis, low, high in zip("xyz", tool.low, tool.high, strict=True):
        if low is not None and high is not None and low >= high:
            raise DynidentError(
                f"the tool's range in {axis} is from {low:g} to {high:g}; the lower end comes first", pointer=at
            )
    if tool.joint is not None and joint_names is not None and tool.joint not in joint_names:
        raise DynidentError(
            f"There is no joint '{tool.joint}'; joints: {', '.join(joint_names)}.",
            pointer=f"{at}/joint",
            title="Unknown joint",
        )
