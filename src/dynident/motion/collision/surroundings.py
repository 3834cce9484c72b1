"""Request fields of floor, walls, boxes, tool range and standing feet, and the default clearance (0.02 m).

Their geometry is elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

from dynident.errors import DynidentError
from dynident.schema.fields import Request, declare_field

SMALLEST_CLEARANCE = 1e-3
"""Smallest clearance that can be asked for, m."""
DEFAULT_CLEARANCE = 0.02
FARTHEST = 1e4
"""Largest coordinate, m: a robot can touch nothing that is farther."""
Vector = tuple[float, float, float]
Ends = tuple[float | None, float | None, float | None]


@dataclass(frozen=True)
class Box(Request):
    """A box in the base frame.

    Parameters
    ----------
    name : str
        Name for margins and messages.
    center : tuple of three float
        Centre in the base frame, m.
    size : tuple of three float
        Lengths of the edges, m.
    rpy : tuple of three float
        Roll, pitch and yaw as in a URDF, rad.
    """

    name: str = declare_field(fewest=1, most=200)
    center: Vector = declare_field("Its centre", unit="m", at_least=-FARTHEST, at_most=FARTHEST)
    size: Vector = declare_field("Its edges", unit="m", above=0, at_most=FARTHEST)
    rpy: Vector = declare_field("Roll, pitch, yaw as in a URDF", default=(0.0, 0.0, 0.0), unit="rad")

    @property
    def solid_name(self) -> str:
        """Name of the box in margins and messages."""
        return f"box '{self.name}'"


@dataclass(frozen=True)
class Wall(Request):
    """A plane that nothing may cross.

    Parameters
    ----------
    name : str
        Name for margins and messages.
    point : tuple of three float
        Any point of the plane in the base frame, m.
    normal : tuple of three float
        A vector to the side that is free, of any length.
    """

    name: str = declare_field(fewest=1, most=200)
    point: Vector = declare_field("Any point on it, in the base frame", unit="m", at_least=-FARTHEST, at_most=FARTHEST)
    normal: Vector = declare_field("Points to the free side")


@dataclass(frozen=True)
class ToolRange(Request):
    """Where the tool may go, m in the base frame.

    Parameters
    ----------
    low : tuple of three float or None
        Smallest x, y, z of the tool in the base frame, m; None for no bound.
    high : tuple of three float or None
        Largest x, y, z of the tool in the base frame, m; None for no bound.
    point : tuple of three float
        The tool in the frame of the joint that carries it, m.
    joint : str, optional
        Name of the joint that carries the tool; the last one where left out.
    """

    low: Ends = declare_field(
        "x, y, z; null: no bound", default=(None, None, None), at_least=-FARTHEST, at_most=FARTHEST
    )
    high: Ends = declare_field(
        "x, y, z; null: no bound", default=(None, None, None), at_least=-FARTHEST, at_most=FARTHEST
    )
    point: Vector = declare_field(
        "Position of the tool in the frame of the joint",
        default=(0.0, 0.0, 0.0),
        unit="m",
        at_least=-FARTHEST,
        at_most=FARTHEST,
    )
    joint: str | None = declare_field("The joint that carries the tool; the last one by default", default=None)


@dataclass(frozen=True)
class Surroundings(Request):
    """What a motion must not touch.

    Parameters
    ----------
    self_collision : bool
        Whether links must not touch each other, as far as the description has collision geometry.
    floor : float or None
        Height of a floor in the base frame, m, that no link but the base may reach.
    assume_floor : bool
        Whether a floor through the base is assumed where nothing around an upright robot is stated.
    walls : tuple of Wall
        Planes that nothing may cross.
    boxes : tuple of Box
        Boxes that nothing may touch.
    tool_range : ToolRange or None
        Where the tool may go.
    clearance : float
        Distance that is kept to everything, m.
    link_radius : float or None
        Radius of the capsules that stand for links without collision geometry, m.
    may_touch : tuple of (str, str)
        Pairs of links or joints that are not checked against each other.
    mesh_folders : tuple of str
        Folders of this machine in which the description's meshes are looked for.
    """

    self_collision: bool = declare_field(
        "Links must not touch each other (checked for links with collision geometry)", default=True
    )
    floor: float | None = declare_field(
        "Height of a floor that only the base may reach, in the base frame",
        default=None,
        unit="m",
        at_least=-FARTHEST,
        at_most=FARTHEST,
    )
    assume_floor: bool = declare_field(
        "Assume a floor through the base of an upright robot if no surroundings are stated", default=True
    )
    walls: tuple[Wall, ...] = declare_field(default=(), most=50)
    boxes: tuple[Box, ...] = declare_field(default=(), most=50)
    tool_range: ToolRange | None = declare_field(default=None)
    clearance: float = declare_field(
        "Smallest distance to all bodies", default=DEFAULT_CLEARANCE, unit="m", at_least=SMALLEST_CLEARANCE, at_most=10
    )
    link_radius: float | None = declare_field(
        "Links without collision geometry count as capsules of this radius between the joints' origins",
        default=None,
        unit="m",
        at_least=1e-4,
        at_most=100,
    )
    may_touch: tuple[tuple[str, str], ...] = declare_field(
        "Pairs of links (or joints) that are not checked against each other", default=(), most=500
    )
    mesh_folders: tuple[str, ...] = declare_field(
        "Folders of this machine in which the description's meshes are looked for", default=(), option="-", local=True
    )

    @property
    def has_obstacles(self) -> bool:
        """Whether there is anything but the robot itself."""
        return self.floor is not None or bool(self.walls) or bool(self.boxes)


@dataclass(frozen=True)
class Standing(Request):
    """Feet that a robot stands on during a motion.

    Parameters
    ----------
    feet : tuple of str
        Links that stand, as contacts are written: "left_foot", whose sole is read from the collision geometry, or a
        point of a link, "calf@0,0,-0.21", or a ball around it, "calf@0,0,-0.21,0.02". None: the base is held.
    friction : float
        Coefficient of friction of the feet on the ground.
    margin : float
        Smallest distance of the centre of pressure from the edge of the support, m.
    sway : tuple of (float, float)
        How far the trunk may move, m, and turn, rad, from home along and about each axis, while the feet stay where
        they are. Zeros: the legs that stand are held.
    """

    feet: tuple[str, ...] = declare_field(
        "Feet that stand, on level ground, while the other joints move: left_foot (sole from the collision geometry), "
        "a point in m, calf@0,0,-0.21, or a ball around it, calf@0,0,-0.21,0.02",
        default=(),
        most=100,
    )
    friction: float = declare_field(
        "Coefficient of friction of standing feet", default=0.5, at_least=0.01, at_most=10, option="--foot-friction"
    )
    margin: float = declare_field(
        "Smallest distance of the centre of pressure from the edge of the support by standing feet",
        default=0.02,
        unit="m",
        at_least=0,
        at_most=FARTHEST,
        option="--balance-margin",
    )
    sway: tuple[float, float] = declare_field(
        "How far the trunk may move (m) and turn (rad) along and about each axis over standing feet, which the legs "
        "keep in place; zeros: the legs are held",
        default=(0.0, 0.0),
        unit="m, rad",
        at_least=0,
        at_most=1,
    )

    @property
    def sways(self) -> bool:
        """Whether the trunk moves."""
        return bool(self.feet) and any(self.sway)

    def refuse_simulation(self) -> None:
        """Raise `DynidentError` where the trunk moves, as simulation holds the base."""
        if self.sways:
            raise DynidentError(
                "The motion of a trunk that sways over its feet cannot be simulated: simulation holds the base.",
                title="Not for a base that moves",
            )
