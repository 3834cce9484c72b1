"""Where a robot's links are, on the wire: enough to draw it in any posture."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from dynident_service.models.common import RequestModel, ViewModel

Point = tuple[float, float, float]


class FrameView(ViewModel):
    """The frame of a joint that carries a link; it moves with its joint."""

    name: str
    type: Literal["revolute", "prismatic"]
    parent: int | None = Field(description="Place of the frame before it in the list; null on the base")
    placement: list[list[float]] = Field(description="4 x 4: from this frame at zero position to the one before it")
    axis: Point = Field(description="Unit vector in this frame that the joint turns about or slides along")
    ratios: list[float] = Field(
        description="Its position is the sum of ratio x position of the robot's joints, plus offset; behind those of "
        "the joints stand the ratios of the passive positions that closed loops determine, if there are any"
    )
    offset: float = Field(description="rad or m")


class CapsuleView(ViewModel):
    """All points within a radius of a segment, fixed to a frame: encloses a part of the link's collision geometry."""

    frame: int | None = Field(description="Place of the frame that it moves with; null on the base")
    start: Point = Field(description="m")
    end: Point = Field(description="m")
    radius: float = Field(description="m")


class SurfaceView(ViewModel):
    """The surface of a link's meshes as triangles, fixed to a frame; thinned, for pictures."""

    frame: int | None = Field(description="Place of the frame that it moves with; null on the base")
    points: list[Point] = Field(description="m")
    triangles: list[tuple[int, int, int]] = Field(description="Places in the list of points")


class LoopEndView(ViewModel):
    """One side of a cut joint: a frame fixed to a link."""

    frame: int | None = Field(description="Place of the frame that it moves with; null on the base")
    placement: list[list[float]] = Field(description="4 x 4: from this side to that frame")


class LoopView(ViewModel):
    """A closed loop: the two sides coincide, wholly, in their origins, or in the xy plane of the first."""

    name: str
    kind: Literal["planar", "point", "full"]
    ends: tuple[LoopEndView, LoopEndView]


class GeometryView(ViewModel):
    """What a picture of the robot needs; lengths in m, angles in rad."""

    joints: list[str] = Field(description="The robot's joints, in the order of ratios")
    frames: list[FrameView] = Field(description="Each behind the one that it stands on")
    capsules: list[CapsuleView]
    surfaces: list[SurfaceView] = Field(default=[], description="Drawn instead of their frame's capsules")
    loops: list[LoopView] = Field(default=[], description="What determines the passive positions")
    closed: list[float] = Field(
        default=[], description="Positions of the robot's joints, then the passive ones, at which all loops are closed"
    )
    notes: list[str] = Field(description="What of the geometry could not be read")


Posture = Annotated[list[float], Field(min_length=1, max_length=200)]


class PosturesRequest(RequestModel):
    """Postures of a robot."""

    positions: list[Posture] = Field(
        min_length=1, max_length=5000, description="Of its joints in their order, rad or m, [posture][joint]"
    )


class PosesView(ViewModel):
    """Where the frames of a robot's geometry are."""

    poses: list[list[list[float] | None]] = Field(
        description="[posture][frame]: 12 numbers, the rotation beside the origin (m) in the base frame, row by row; "
        "null for what moves in a loop that cannot be closed there"
    )
