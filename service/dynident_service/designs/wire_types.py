"""Bodies and answers of designs and simulations."""

from __future__ import annotations

from math import inf
from typing import Annotated, Self

from pydantic import Field, model_validator

from dynident.excitation.criteria.criterion_choice import CriterionChoice
from dynident.excitation.design_request import DesignRequest as Designed
from dynident.excitation.design_request import TrajectoryRequest
from dynident.recordings.recording_metadata import Role
from dynident.simulation.virtual_robot_request import ActingEffect, Simulated, list_usual_effects
from dynident.simulation.virtual_robot_request import Sensors as Sensing
from dynident_service.problems import RemedyView
from dynident_service.robots.wire_types import Limits, Point
from dynident_service.shared.request_bodies import derive_body
from dynident_service.shared.wire_types import (
    Computed,
    Effects,
    Identifier,
    NamedRequest,
    RequestModel,
    SourcePath,
    ViewModel,
    WithTables,
)


@derive_body(CriterionChoice)
class Criterion(RequestModel):
    """How exciting a motion is (§12.3.4.1)."""

    effects: Effects = Field(default=[])


@derive_body(TrajectoryRequest)
class Trajectory(RequestModel):
    """The family of trajectories."""


@derive_body(Designed, or_null=("model",))
class DesignRequest(NamedRequest):
    """A request to design an experiment."""

    robot_id: Identifier
    effects: Effects | None = None
    limits: dict[str, Limits] = Field(default={})
    earlier_ids: list[Identifier] = Field(
        default=[], max_length=100, description="Measurements that the new experiment should complement"
    )
    identification_id: Identifier | None = Field(
        default=None,
        description="Model of the robot by which torque is predicted for its limits: friction and rotors count, and a "
        "margin for what is uncertain. By default, the inertias of the description alone",
    )


_OrInfinite = Annotated[float | None, SourcePath(null=inf)]


class CriterionValues(ViewModel):
    """How well a motion excites the parameters; singular values are those of W / √N."""

    condition_number: _OrInfinite = Field(description="[12.12], in SI units; null if W does not have full rank")
    scaled_condition_number: _OrInfinite = Field(
        default=None,
        description="Of columns of equal size, without units; null if W does not have full rank, and of older designs",
    )
    criterion: _OrInfinite
    smallest_singular_value: _OrInfinite
    largest_singular_value: _OrInfinite
    log_determinant: Annotated[float | None, SourcePath(null=-inf)]
    trace_of_inverse: _OrInfinite


class BaselineValues(CriterionValues):
    """The best of the random trajectories."""

    count: int
    median_condition_number: _OrInfinite
    median_scaled_condition_number: _OrInfinite = None


class Margin(ViewModel):
    """How close the motion comes to a limit, on a fine grid."""

    joint: str = Field(
        description="The joint; for a clearance, the two bodies that come close to each other; for a condition: loops"
    )
    limit: str = Field(
        description="position_min, position_max, velocity, …, torque, power, clearance, tool_min, tool_max, condition, "
        "balance (centre of pressure from the edge of the support, m) or friction"
    )
    value: float = Field(description="The extreme value")
    bound: float
    share: _OrInfinite = Field(description="Share of the available range that is used: 1 reaches the limit")


class ExpectedParameter(ViewModel):
    """Expected accuracy of one parameter."""

    name: str
    effect: str
    link: str
    unit: str
    share: float = Field(description="Share of its column that the other columns do not explain; 0: not determined")
    standard_deviation: float | None = Field(
        description="null if no noise is stated or the parameter is not determined"
    )


class Run(ViewModel):
    """One test motion of a set."""

    label: str
    joints: list[str] = Field(description="Joints that move; the others are locked")
    start: float = Field(description="s")
    end: float = Field(description="s")


class DesignResult(ViewModel):
    """A verified experiment."""

    criterion_values: CriterionValues
    baseline_values: BaselineValues | None
    margins: list[Margin]
    n_samples: int
    sampling_rate: float
    duration: float = Field(description="Duration in s, from home to home")
    exciting: tuple[float, float] = Field(description="Start and end of the exciting part, s")
    period: float | None
    parameter_names: list[str]
    expected_parameters: Annotated[list[ExpectedParameter], SourcePath("expected")] = Field(
        default=[], description="Expected accuracy of the parameters"
    )
    joints: Annotated[list[str], SourcePath("joint_names")]
    runs: list[Run] = Field(
        default=[], description="Runs of a set of test motions; the column segment of the trajectory has their numbers"
    )
    notes: list[str]
    warnings: list[str] = Field(default=[], description="Notes that everybody must read before running the motion")
    warning_codes: list[str] = Field(default=[], description="What each of the warnings is about, in the same order")
    remedies: list[RemedyView] = Field(default=[], description="Those that notes and warnings quote")
    floor: float | None = Field(
        default=None,
        description="Height in m of the floor that was checked, in the base frame; if the request states none, the "
        "floor was assumed. null: no floor was checked",
    )
    promised: list[float | None] | None = Field(
        default=None,
        description="For a motion of a campaign: errors that it leaves, by target of the campaign; null of one without "
        "a bound, as the centre of a load that does not show yet",
    )


class TrajectorySamples(ViewModel):
    """A trajectory sample by sample, [sample][joint]."""

    joints: list[str]
    t: list[float]
    q: list[list[float]]
    dq: list[list[float]]
    ddq: list[list[float]]


class Other(ViewModel):
    """What a link may come close to: another link, or a part of the surroundings."""

    name: str
    frame: int | None = Field(description="Index of the frame in the robot's geometry; null for the base")


class LinkClearances(ViewModel):
    """What a link is closest to, sample by sample: the body with the least clearance beyond the required distance."""

    name: str
    frame: int = Field(description="Index of the frame in the robot's geometry")
    others: list[Other]
    to: list[int] = Field(description="Index in the others")
    distance: list[float] = Field(description="m; negative if they overlap")
    wanted: list[float] = Field(description="m")
    here: list[Point] = Field(description="Nearest point on the link, in its frame, m")
    there: list[Point] = Field(description="Nearest point on the other body, in its own frame, m")


class WallPlane(ViewModel):
    """The plane of a wall."""

    point: Point = Field(description="m, in the base frame")
    along: tuple[Point, Point] = Field(description="Orthogonal unit vectors in the plane")


class DesignClearances(ViewModel):
    """Clearances of each link along a motion, to other links and to the surroundings, with their shapes."""

    t: list[float] = Field(description="s")
    links: list[LinkClearances] = Field(description="The links whose clearance is checked")
    edges: list[tuple[Point, Point]] = Field(
        description="Edges of the boxes around the robot: their end points, m, in the base frame"
    )
    walls: list[WallPlane]


class DesignView(Computed[DesignRequest, DesignResult], WithTables):
    """A design."""


@derive_body(ActingEffect)
class TrueEffect(RequestModel):
    """An effect of the virtual robot; without parameters, of a size as found on real arms."""


@derive_body(Sensing, "sampling_rate")
class Noise(RequestModel):
    """Sensors of the virtual robot."""


MOST_ROWS = 2_000_000
Row = Annotated[list[float], Field(fail_fast=True, max_length=200)]
Rows = Annotated[list[Row], Field(fail_fast=True, max_length=MOST_ROWS)]
"""[sample][joint]; the first that is wrong is told, not all of a million."""


class Samples(RequestModel):
    """A trajectory sample by sample: [sample][joint]; derivatives that are not given follow from q."""

    t: list[float] = Field(min_length=2, max_length=MOST_ROWS, fail_fast=True)
    q: Rows = Field(min_length=2)
    dq: Rows | None = None
    ddq: Rows | None = None


@derive_body(Simulated)
class SimulationRequest(NamedRequest):
    """A request to simulate a measurement of a virtual robot."""

    robot_id: Identifier
    effects: list[TrueEffect] = Field(
        max_length=1000,
        default=[TrueEffect.model_validate({"effect": effect.effect}) for effect in list_usual_effects()],
    )
    trajectory: Samples | Trajectory | None = Field(
        default=None, description="Samples; or a family, from which a random motion within the limits is drawn."
    )
    design_id: Identifier | None = None
    role: Role | None = None

    @model_validator(mode="after")
    def _check_one_motion(self) -> Self:
        if (self.trajectory is None) == (self.design_id is None):
            raise ValueError("give either trajectory or design_id")
        return self


class SimulationResult(ViewModel):
    """The measurement of the virtual robot."""

    measurement_id: str = ""
    n_samples: int
    sampling_rate: float
    noise: list[float] = Field(
        description="Standard deviation of the torque noise per joint: no model can predict better."
    )
    tracking_error: list[float] = Field(description="Largest deviation from the reference per joint")


class SimulationView(Computed[SimulationRequest, SimulationResult]):
    """A simulation."""
