"""Bodies and answers of robots, their geometry and poses."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field

from dynident.robot import limits_and_drives as stated
from dynident.robot.description_formats import FORMATS, BaseKind, DescriptionFormat
from dynident.robot.limits_and_drives import HARDWARE
from dynident_service.shared.request_bodies import derive_body, describe_choices
from dynident_service.shared.wire_types import Labelled, LabelsRequest, Name, RequestModel, ViewModel

Point = tuple[float, float, float]


class FrameView(ViewModel):
    """The frame of a joint that carries a link; it moves with its joint."""

    name: str
    type: Literal["revolute", "prismatic"]
    parent: int | None = Field(description="Index of the preceding frame in the list; null on the base")
    placement: list[list[float]] = Field(description="4 x 4: from this frame at zero position to the preceding one")
    axis: Point = Field(description="Unit vector in this frame: the axis of rotation or the direction of translation")
    ratios: list[float] = Field(
        description="Its position is the sum of ratio x position of the robot's joints, plus offset; after the ratios "
        "of the joints come those of the passive positions that closed loops determine, if there are any"
    )
    offset: float = Field(description="rad or m")


class CapsuleView(ViewModel):
    """All points within a radius of a segment, fixed to a frame: encloses a part of the link's collision geometry."""

    frame: int | None = Field(description="Index of the frame that it moves with; null on the base")
    start: Point = Field(description="m")
    end: Point = Field(description="m")
    radius: float = Field(description="m")


class SurfaceView(ViewModel):
    """The surface of a link's meshes as triangles, fixed to a frame; thinned, for pictures."""

    frame: int | None = Field(description="Index of the frame that it moves with; null on the base")
    points: list[Point] = Field(description="m")
    triangles: list[tuple[int, int, int]] = Field(description="Indices in the list of points")


class LoopEndView(ViewModel):
    """One side of a cut joint: a frame fixed to a link."""

    frame: int | None = Field(description="Index of the frame that it moves with; null on the base")
    placement: list[list[float]] = Field(description="4 x 4: from this side to that frame")


class LoopView(ViewModel):
    """A closed loop: its two sides coincide completely, in their origins, or in the xy plane of the first side."""

    name: str
    kind: Literal["planar", "point", "full"]
    ends: tuple[LoopEndView, LoopEndView]


class GeometryView(ViewModel):
    """Geometry for a picture of the robot; lengths in m, angles in rad."""

    joints: list[str] = Field(description="The robot's joints, in the order of ratios")
    frames: list[FrameView] = Field(description="Each frame after the one that it is attached to")
    capsules: list[CapsuleView]
    surfaces: list[SurfaceView] = Field(default=[], description="Drawn instead of the capsules of their frame")
    loops: list[LoopView] = Field(default=[], description="The closed loops, which determine the passive positions")
    closed: list[float] = Field(
        default=[], description="Positions of the robot's joints, then the passive ones, at which all loops are closed"
    )
    notes: list[str] = Field(description="Parts of the geometry that could not be read")


HardwareName = Annotated[str, Field(max_length=40, json_schema_extra={"examples": list(HARDWARE)})]

Posture = Annotated[list[float], Field(min_length=1, max_length=200)]


class PosturesRequest(RequestModel):
    """Postures of a robot."""

    positions: list[Posture] = Field(
        min_length=1, max_length=5000, description="Positions of the joints in order, rad or m, [posture][joint]"
    )


class PosesView(ViewModel):
    """Where the frames of a robot's geometry are."""

    poses: list[list[list[float] | None]] = Field(
        description="[posture][frame]: the 12 numbers of the 3 x 4 matrix [rotation, origin (m)] in the base frame, "
        "row by row; null for frames in a loop that cannot be closed there"
    )


class Description(RequestModel):
    """The description of the robot."""

    format: DescriptionFormat = Field(json_schema_extra=describe_choices(FORMATS))
    content: str | dict[str, Any] = Field(
        description="The URDF or MJCF; a modified Denavit-Hartenberg table as JSON; or, for dh, a classical or "
        "modified table as text, whose first line names the kind."
    )


@derive_body(stated.Limits)
class Limits(RequestModel):
    """Limits of one joint: rad or m, rad/s or m/s, …, N m or N, and W."""


@derive_body(stated.Drive)
class Drive(RequestModel):
    """The drive chain of a joint [12.17]: torque = drive_gain x recorded current."""


class MeshView(ViewModel):
    """A mesh that the description uses for collisions."""

    name: str = Field(description="As in the description: package://…, or a path")
    links: list[str] = Field(description="The links that use it")
    sha256: str | None = Field(default=None, description="Hash of the uploaded file; null if none was uploaded.")
    size: int | None = Field(default=None, description="Bytes")


class MeshesView(ViewModel):
    """The result of an upload of meshes."""

    meshes: list[MeshView] = Field(description="All meshes that the description names, in its order")
    unused: list[str] = Field(description="Uploaded files that match no mesh of the description")


class RobotRequest(RequestModel):
    """A request to store a robot."""

    name: Name
    description: Description
    limits: dict[str, Limits] = Field(default={}, description="By joint; these replace the limits of the description.")
    drives: dict[str, Drive] = Field(default={}, description="By joint")
    locked_joints: dict[str, float] = Field(default={}, description="Joint to position, rad or m")
    gravity: tuple[float, float, float] | None = Field(default=None, description="m/s² in the base frame")
    base: BaseKind | None = Field(
        default=None, description="How the root link moves; null: as the description says, such as by a floating joint."
    )
    contacts: list[str] = Field(
        default=[],
        max_length=20,
        description="Feet of a floating robot whose forces were not measured: left_foot, a point, calf@0,0,-0.21, or a "
        "ball around it, calf@0,0,-0.21,0.02; ^0.03 behind it: on level ground nothing acts on it where it is so far "
        "(m) above the lowest foot, and from twice this height on it is not eliminated. The height is that of the "
        "point, or of the link's frame: keep soles flat, or state more than the ankle rises while toe or heel touches",
    )
    meshes_of: str | None = Field(
        default=None,
        description="A robot whose uploaded meshes are also used for this one, if their names are the same.",
    )
    has: list[HardwareName] = Field(default=[], max_length=20, description="Parts that the robot has")
    has_not: list[HardwareName] = Field(
        default=[], max_length=20, description="Parts that it does not have: diagnoses do not propose their effects"
    )
    base_parameters_tolerance: float | None = Field(
        default=None, gt=0, lt=0.1, description="Share of a column that other columns may leave unexplained."
    )


class JointView(ViewModel):
    """One moving joint."""

    name: str
    type: Literal["revolute", "prismatic"]
    limits: Limits
    antecedent: str | None = Field(description="The preceding joint; null on the base.")
    link: str
    drive_gain: float | None = None
    coupling: dict[str, float] = Field(default={}, description="Other joints that its motor acts on.")


class BaseParametersView(ViewModel):
    """The smallest set of inertial parameters that determines the model."""

    count: int
    rank: int = Field(description="Numerical rank of the observation matrix: an independent check of the number.")
    names: list[str]
    groupings: list[str] = Field(description="Each as a sum of standard parameters.")


class RobotResult(ViewModel):
    """The result for a robot."""

    joints: list[JointView]
    base_parameters: BaseParametersView
    has_inertias: bool = Field(description="Whether the description gives inertial parameters.")
    base: BaseKind = Field(
        default="fixed", description="How the root link moves; the coordinates of a moving base are the first joints."
    )
    meshes: list[MeshView] = Field(
        default=[], description="For collisions and pictures; upload their files to /v1/robots/{id}/meshes."
    )


class RobotChanges(LabelsRequest):
    """Changes to a robot's labels and to what is known of its parts; fields that are not given keep their values."""

    has: list[HardwareName] | None = Field(
        default=None, max_length=20, description="All parts that the robot has: they replace those stated before"
    )
    has_not: list[HardwareName] | None = Field(
        default=None, max_length=20, description="All parts that it does not have: they replace those stated before"
    )


class LimbView(ViewModel):
    """A chain of joints between two branchings of the robot's tree, or the whole robot."""

    title: str = Field(description="In words")
    joints: list[str] = Field(description="From the base outwards")
    parent: int | None = Field(description="Index of the limb that it branches off from; null for the whole robot")


class RobotView(RobotResult, Labelled):
    """A stored robot."""

    id: str
    name: str
    created_at: datetime
    has: list[str] = Field(default=[], description="Parts that the robot has")
    has_not: list[str] = Field(default=[], description="Parts that it does not have")
    limbs: list[LimbView] = Field(
        default=[], description="The whole robot and its limbs, outwards; empty for a robot that does not branch"
    )
    request: RobotRequest


class KnownRobot(ViewModel):
    """A well-known arm."""

    name: str
    source: str = Field(description="Where its limits and inertial parameters are from")
    description: dict[str, str] = Field(description="For POST /v1/robots: format and content")


class KnownRobots(ViewModel):
    """The well-known arms, by name."""

    items: list[KnownRobot]
