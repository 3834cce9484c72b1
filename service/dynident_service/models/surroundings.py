"""What stands around a robot, on the wire."""

from __future__ import annotations

from pydantic import Field

from dynident_service.models.common import Asked, Name

Vector = tuple[float, float, float]
Ends = tuple[float | None, float | None, float | None]


class Box(Asked):
    """A box in the base frame."""

    name: Name
    center: Vector = Field(description="m")
    size: Vector = Field(description="Its edges, m")
    rpy: Vector = Field(default=(0.0, 0.0, 0.0), description="Roll, pitch, yaw, rad")


class Wall(Asked):
    """A plane that nothing may cross."""

    name: Name
    point: Vector = Field(description="Any point on it, m in the base frame")
    normal: Vector = Field(description="To the side that is free")


class ToolRange(Asked):
    """Where the tool may go, m in the base frame."""

    low: Ends = Field(default=(None, None, None), description="x, y, z; null: no bound")
    high: Ends = Field(default=(None, None, None), description="x, y, z; null: no bound")
    point: Vector = Field(default=(0.0, 0.0, 0.0), description="The tool in the frame of the joint, m")
    joint: str | None = Field(default=None, description="The joint that carries it; the last one")


class Surroundings(Asked):
    """What a motion must not touch."""

    self_collision: bool = Field(
        default=True, description="Links must not touch each other, as far as the description has collision geometry"
    )
    floor: float | None = Field(default=None, description="Height of the floor, m in the base frame")
    walls: list[Wall] = Field(default=[], max_length=50)
    boxes: list[Box] = Field(default=[], max_length=50)
    tool_range: ToolRange | None = None
    clearance: float = Field(default=0.02, description="Distance that is kept to everything, m")
    link_radius: float | None = Field(
        default=None, description="Links without collision geometry count as capsules of this radius, m"
    )
    may_touch: list[tuple[str, str]] = Field(
        default=[], max_length=500, description="Pairs of links that are not checked against each other"
    )
