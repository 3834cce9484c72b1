"""What stands around the robot, as the user states it: floor, walls, boxes, and where the tool may go."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.motion.surroundings.stated import Box, Surroundings, ToolRange, Wall
from dynident.robot.pointers import pointer
from dynident.robot.shapes import Block

__all__ = [
    "Box",
    "HalfSpace",
    "Surroundings",
    "ToolRange",
    "Wall",
    "block_of",
    "check_surroundings",
    "half_spaces_of",
]

_AT = "/surroundings"
_LEAST_CLEARANCE = 1e-3


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The free side of a plane: normal · x ≥ offset (m, base frame), with a unit normal (3,)."""

    name: str
    normal: FloatArray
    offset: float


def block_of(box: Box) -> Block:
    """A box as a shape in the base frame."""
    placement = np.eye(4)
    placement[:3, :3] = Rotation.from_euler("xyz", box.rpy).as_matrix()
    placement[:3, 3] = box.center
    return Block(placement, np.array(box.size))


def half_spaces_of(surroundings: Surroundings) -> tuple[HalfSpace, ...]:
    """Floor and walls."""
    made = [] if surroundings.floor is None else [HalfSpace("floor", np.array([0.0, 0.0, 1.0]), surroundings.floor)]
    for wall in surroundings.walls:
        normal = np.array(wall.normal) / np.linalg.norm(wall.normal)
        made.append(HalfSpace(f"wall '{wall.name}'", normal, float(normal @ np.array(wall.point))))
    return tuple(made)


def check_surroundings(surroundings: Surroundings, joint_names: Sequence[str] | None = None) -> None:
    """Raise `DynidentError` for what is no obstacle, no range or no distance; the joint where names are given."""
    if surroundings.floor is not None:
        _finite((surroundings.floor,), "the floor's height", f"{_AT}/floor")
    _more_than(surroundings.clearance, _LEAST_CLEARANCE, "clearance", f"{_AT}/clearance")
    if surroundings.link_radius is not None:
        _more_than(surroundings.link_radius, 0.0, "link_radius", f"{_AT}/link_radius")
    for index, wall in enumerate(surroundings.walls):
        at = pointer(index, within=f"{_AT}/walls")
        _finite(wall.point, f"the point of wall '{wall.name}'", f"{at}/point")
        _finite(wall.normal, f"the normal of wall '{wall.name}'", f"{at}/normal")
        if not any(wall.normal):
            raise DynidentError(
                f"the normal of wall '{wall.name}' is zero; it must point to the side that is free",
                pointer=f"{at}/normal",
            )
    for index, box in enumerate(surroundings.boxes):
        at = pointer(index, within=f"{_AT}/boxes")
        _finite(box.center, f"the centre of box '{box.name}'", f"{at}/center")
        _finite(box.rpy, f"rpy of box '{box.name}'", f"{at}/rpy")
        for edge in box.size:
            _more_than(edge, 0.0, f"an edge of box '{box.name}'", f"{at}/size")
    if surroundings.tool_range is not None:
        _check_tool(surroundings.tool_range, joint_names)


def _check_tool(tool: ToolRange, joint_names: Sequence[str] | None) -> None:
    at = f"{_AT}/tool_range"
    _finite(tool.point, "the tool's point", f"{at}/point")
    for axis, low, high in zip("xyz", tool.low, tool.high, strict=True):
        _finite([end for end in (low, high) if end is not None], f"the tool's range in {axis}", at)
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


def _finite(values: Iterable[float], what: str, at: str) -> None:
    if not all(np.isfinite(value) for value in values):
        raise DynidentError(f"{what} has numbers that are not finite", pointer=at)


def _more_than(value: float, least: float, what: str, at: str) -> None:
    if not (np.isfinite(value) and value > 0 and value >= least):
        wanted = f"at least {least:g} m" if least else "a positive number of m"
        raise DynidentError(f"{what} is {value}; it must be {wanted}", pointer=at)
