"""Bodies and answers of campaigns."""

from __future__ import annotations

from datetime import datetime
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from dynident.advice.campaign_request import LONGEST_CAMPAIGN, MOTION_WORDS
from dynident.advice.campaign_request import CampaignRequest as Requested
from dynident.excitation.design_request import DesignRequest
from dynident_service.designs.wire_types import Trajectory
from dynident_service.problems import Problem
from dynident_service.robots.wire_types import Limits
from dynident_service.shared.request_bodies import derive_body
from dynident_service.shared.wire_types import (
    EffectChoice,
    Effects,
    Identifier,
    NamedRequest,
    Progress,
    RequestModel,
    SourcePath,
    ViewModel,
    WithTables,
)

MOST_STEPS = 500
"""Motions, and models, of a campaign that are looked through."""
CampaignPhase = Literal["asking", "designing", "waiting", "estimating", "reached", "unreachable", "stopped"]
# The library counts minutes.
_MINUTE = 60.0


@derive_body(Requested, only=("error", "speed"))
class TorqueGoal(RequestModel):
    """Torque that is predicted as well as asked for."""

    kind: Literal["torque"] = "torque"
    region_ids: list[Identifier] = Field(
        default=[],
        max_length=100,
        description="Recordings of the application, for whose motions the torque is to be predicted; by default all "
        "states within the limits, up to `speed`",
    )


@derive_body(Requested, only=("error",))
class ParametersGoal(RequestModel):
    """Base parameters that are known as well as asked for."""

    kind: Literal["parameters"] = "parameters"
    parameters: list[str] = Field(min_length=1, max_length=1000, description="Names of base parameters")


class EffectsGoal(RequestModel):
    """Effects that are found, or would have shown at their usual size on every joint."""

    kind: Literal["effects"] = "effects"
    effects: list[str] = Field(min_length=1, max_length=100, description="Ids of effects from GET /v1/effects")


@derive_body(Requested, only=("mass_error", "centre_error", "unloaded_runs"))
class PayloadGoal(RequestModel):
    """A load on the last link whose mass and centre are known as well as asked for."""

    kind: Literal["payload"] = "payload"
    quantities: list[Literal["mass", "centre_x", "centre_y", "centre_z"]] = Field(
        default=["mass"],
        min_length=1,
        max_length=4,
        description="What is to be known; the centre is in the frame of the last joint",
    )


@derive_body(Requested, only=("runs",))
class Budget(RequestModel):
    """What a campaign may cost."""

    robot_time: float = Field(
        default=_MINUTE * Requested.minutes,
        gt=0,
        le=_MINUTE * LONGEST_CAMPAIGN,
        description="Time of all runs together, in s",
        json_schema_extra={"x-unit": "s"},
    )


@derive_body(
    DesignRequest,
    only=(
        "home",
        "starts",
        "random_trajectories",
        "seed",
        "torque_margin",
        "surroundings",
        "time_budget",
    ),
    words=MOTION_WORDS,
)
@derive_body(Requested, only=("first_speed",))
class CampaignRequest(NamedRequest):
    """A goal, what it may cost, and what every motion must keep to."""

    robot_id: Identifier
    goal: Annotated[TorqueGoal | ParametersGoal | EffectsGoal | PayloadGoal, Field(discriminator="kind")] = TorqueGoal()
    budget: Budget = Budget()
    measurement_ids: list[Identifier] = Field(
        default=[], max_length=100, description="Recordings that already exist and that the campaign uses first"
    )
    effects: Effects | None = Field(default=None, description="Effects of the first model; by default the usual ones")
    limits: dict[str, Limits] = Field(default={})
    trajectory: Trajectory = Trajectory()

    @model_validator(mode="before")
    @classmethod
    def _default_to_torque(cls, values: Any) -> Any:
        # The kind decides which fields a goal has; torque is the goal of requests that do not state it.
        goal = values.get("goal") if isinstance(values, dict) else None
        return {**values, "goal": {"kind": "torque", **goal}} if isinstance(goal, dict) else values

    @property
    def region_ids(self) -> list[Identifier]:
        """The measurements whose torque shall be predicted; none for other goals."""
        return self.goal.region_ids if isinstance(self.goal, TorqueGoal) else []


class TellRequest(RequestModel):
    """The recording of a run."""

    measurement_id: Identifier
    design_id: Identifier | None = Field(
        default=None, description="The motion that was executed; by default, the last one that was designed"
    )


class CampaignRunView(ViewModel):
    """One run of a campaign, as it stood after its recording was taken in; errors are relative, by target."""

    measurement_id: str = ""
    design_id: str | None = None
    name: str
    seconds: float
    promised: list[float | None] | None = Field(
        description="Errors that its motion promised; null if the run was not planned, or for a target without a bound"
    )
    predicted: list[float] | None = Field(
        description="Errors of this run's torque, predicted by the model before this run; null for the first run"
    )
    parameters: list[float | None] = Field(
        description="Errors (95 %) from uncertain parameters; of a load, relative to the requested error. Null for an "
        "effect that would not have shown at any size, and for a load before it is mounted"
    )
    lacking: list[float] = Field(description="Errors over the region, from what the model lacks")
    achieved: Annotated[list[float | None], SourcePath("errors")] = Field(
        description="Root of the sum of the squares of both errors"
    )
    added: list[EffectChoice] = Field(description="Effects that the campaign added to the model")
    is_changed: bool = Field(description="Whether the added effects differ from those after the previous run")


class CampaignDecision(ViewModel):
    """What to do next, and why."""

    code: Literal["next_run", "reached", "not_reachable", "out_of_time"]
    sentence: str


class CampaignOutcome(ViewModel):
    """What a campaign made of the recordings that it was told."""

    runs: list[CampaignRunView]
    decision: CampaignDecision


class CampaignStep(ViewModel):
    """A motion that was asked for, or a recording that was told."""

    kind: Literal["ask", "tell"]
    design_id: str | None = Field(description="The motion")
    identification_id: str | None = Field(description="The model from all recordings so far; null of a motion")
    job_id: str
    status: str
    progress: Progress
    error: Problem | None = None
    promised: list[float | None] | None = Field(
        default=None, description="Errors that the motion promises, by target; null of one without a bound"
    )
    duration: float | None = Field(default=None, description="Length of the motion, s")
    runs: list[CampaignRunView] = Field(default=[], description="What the recordings brought")


class CampaignView(WithTables):
    """A campaign."""

    id: str
    name: str | None
    created_at: datetime
    request: CampaignRequest
    joints: list[str]
    targets: list[str] = Field(
        description="What the errors are of: joints, parameters, effects or quantities of a load, by name"
    )
    state: CampaignPhase = Field(
        description="asking: the next motion has to be designed; waiting: execute it and send its recording; stopped: "
        "the budget is used up"
    )
    decision: CampaignDecision
    robot_time: float = Field(description="Robot time of all runs so far, s")
    promised: float | None = Field(description="Error of the worst target that the last motion promises")
    achieved: float | None = Field(description="Error of the worst target after the last run")
    design_id: str | None = Field(description="The motion to make; null if none is waiting")
    identification_id: str | None = Field(description="The model from all runs; null before the first")
    steps: list[CampaignStep] = Field(description="In order")
