"""What stands around the robot, as the user states it: floor, walls, boxes, and where the tool may go."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from dynident.arrays import FloatArray
from dynident.errors import DynidentError
from dynident.robot.pointers import pointer
from dynident.robot.shapes import Block

DEFAULT_CLEARANCE = 0.02
_AT = "/surroundings"
_LEAST_CLEARANCE = 1e-3
Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Box:
    """A box: `center` and edges `size` in m in the base frame, turned by roll, pitch, yaw (rad, as in a URDF)."""

    name: str
    center: Vector
    size: Vector
    rpy: Vector = (0.0, 0.0, 0.0)

    @property
    def solid_name(self) -> str:
        """As it is called in margins and messages."""
        return f"box '{self.name}'"

    @property
    def block(self) -> Block:
        """The same as a shape in the base frame."""
        placement = np.eye(4)
        placement[:3, :3] = Rotation.from_euler("xyz", self.rpy).as_matrix()
        placement[:3, 3] = self.center
        return Block(placement, np.array(self.size))


@dataclass(frozen=True)
class Wall:
    """A plane through `point` (m, base frame) that nothing may cross; `normal` points to the side that is free."""

    name: str
    point: Vector
    normal: Vector


@dataclass(frozen=True, eq=False)
class HalfSpace:
    """The free side of a plane: normal · x ≥ offset (m, base frame), with a unit normal (3,)."""

    name: str
    normal: FloatArray
    offset: float


@dataclass(frozen=True)
class ToolRange:
    """Where the tool may go: from `low` to `high` (x, y, z in m, base frame; `None`: no bound).

    The tool is `point` (m) in the frame of `joint`, by default the origin of the last one.
    """

    low: tuple[float | None, float | None, float | None] = (None, None, None)
    high: tuple[float | None, float | None, float | None] = (None, None, None)
    point: Vector = (0.0, 0.0, 0.0)
    joint: str | None = None


@dataclass(frozen=True)
class Surroundings:
    """What a motion must not touch.

    Parameters
    ----------
    self_collision : bool
        Whether the links must not touch each other, as far as the robot's description has collision geometry.
    floor : float, optional
        Height in m of a floor that no link but the base may reach.
    walls, boxes : tuples of Wall and Box
    tool_range : ToolRange, optional
    clearance : float
        Distance in m that is kept to everything.
    link_radius : float, optional
        Links without collision geometry count as capsules of this radius (m) between the joints' origins.
    may_touch : tuple of pairs of names
        Pairs of links (or joints) that are not checked against each other.
    mesh_folders : tuple of str
        Folders in which the description's meshes are looked for.
    """

    self_collision: bool = True
    floor: float | None = None
    walls: tuple[Wall, ...] = ()
    boxes: tuple[Box, ...] = ()
    tool_range: ToolRange | None = None
    clearance: float = DEFAULT_CLEARANCE
    link_radius: float | None = None
    may_touch: tuple[tuple[str, str], ...] = ()
    mesh_folders: tuple[str, ...] = ()

    @property
    def has_obstacles(self) -> bool:
        """Whether there is anything but the robot itself."""
        return self.floor is not None or bool(self.walls) or bool(self.boxes)

    @property
    def half_spaces(self) -> tuple[HalfSpace, ...]:
        """Floor and walls."""
        made = [] if self.floor is None else [HalfSpace("floor", np.array([0.0, 0.0, 1.0]), self.floor)]
        for wall in self.walls:
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
