"""Robots on the wire."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from dynident.robot import limits as stated
from dynident.robot.formats import FORMATS, DescriptionFormat
from dynident_service.models.common import Labelled, Name, RequestModel, ViewModel
from dynident_service.models.request_bodies import derive_body, describe_choices


class Description(RequestModel):
    """What the robot is made from."""

    format: DescriptionFormat = Field(json_schema_extra=describe_choices(FORMATS))
    content: str | dict[str, Any] = Field(
        description="The URDF or MJCF; the modified Denavit-Hartenberg table, as JSON; or, as dh, a classical or "
        "modified table as text, whose first line says which."
    )


@derive_body(stated.Limits)
class Limits(RequestModel):
    """Limits of one joint: rad or m, rad/s or m/s, …, N m or N, and W."""


@derive_body(stated.Drive)
class Drive(RequestModel):
    """The drive chain of a joint [12.17]: torque = drive_gain x recorded current."""


class MeshView(ViewModel):
    """A mesh that the description names for collisions."""

    name: str = Field(description="As in the description: package://…, or a path")
    links: list[str] = Field(description="The links that it is of")
    sha256: str | None = Field(default=None, description="Of the file that was sent for it; null where none was.")
    size: int | None = Field(default=None, description="Bytes")


class MeshesView(ViewModel):
    """What came of the meshes that were sent."""

    meshes: list[MeshView] = Field(description="All that the description names, in its order")
    unused: list[str] = Field(description="Files that were sent and that no mesh of the description means")


class RobotRequest(RequestModel):
    """A robot to be stored."""

    name: Name
    description: Description
    limits: dict[str, Limits] = Field(default={}, description="By joint; these win over the description's.")
    drives: dict[str, Drive] = Field(default={}, description="By joint")
    locked_joints: dict[str, float] = Field(default={}, description="Joint to position, rad or m")
    gravity: tuple[float, float, float] | None = Field(default=None, description="m/s² in the base frame")
    meshes_of: str | None = Field(
        default=None, description="A robot whose uploaded meshes this one has, too, where their names are the same."
    )
    base_parameters_tolerance: float | None = Field(
        default=None, gt=0, lt=0.1, description="Share of a column that others may leave unexplained."
    )


class JointView(ViewModel):
    """One moving joint."""

    name: str
    type: Literal["revolute", "prismatic"]
    limits: Limits
    antecedent: str | None = Field(description="The joint before it; null on the base.")
    link: str
    drive_gain: float | None = None
    coupling: dict[str, float] = Field(default={}, description="Other joints that its motor acts on.")


class BaseParametersView(ViewModel):
    """The smallest set of inertial parameters that determines the model."""

    count: int
    rank: int = Field(description="Numerical rank of the observation matrix: a second opinion on the count.")
    names: list[str]
    groupings: list[str] = Field(description="Each written out in standard parameters.")


class RobotResult(ViewModel):
    """What follows from the description."""

    joints: list[JointView]
    base_parameters: BaseParametersView
    has_inertias: bool = Field(description="Whether the description gives inertial parameters.")
    meshes: list[MeshView] = Field(
        default=[], description="For collisions and pictures; their files are sent to /v1/robots/{id}/meshes."
    )


class RobotView(RobotResult, Labelled):
    """A stored robot."""

    id: str
    name: str
    created_at: datetime
    request: RobotRequest
