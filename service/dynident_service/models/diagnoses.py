"""Diagnoses, and series of days, on the wire."""

from __future__ import annotations

from math import inf
from typing import Annotated, Any, Literal

from pydantic import Field

from dynident.diagnosis.request import DiagnosisChoices
from dynident_service.models.common import Computed, EffectChoice, Identifier, NamedRequest, SourcePath, ViewModel
from dynident_service.models.request_bodies import derive_body


@derive_body(DiagnosisChoices, or_null=("max_effects",))
class DiagnosisRequest(NamedRequest):
    """Which model is questioned, on which measurements."""

    identification_id: Identifier
    measurement_ids: list[Identifier] | None = Field(
        default=None, min_length=1, max_length=100, description="Those it was identified from where not given."
    )
    baseline_ids: list[Identifier] = Field(
        default=[], max_length=100, description="Earlier measurements of the same robot: what differs since is told."
    )


class Candidate(ViewModel):
    """One family of effects, at its best place and shape; errors are relative, held out, on the joints named."""

    rank: int
    effect: Annotated[str, SourcePath("choice.effect")]
    joints: Annotated[list[str], SourcePath("choice.joints")]
    error_before: float | None
    error_after: float | None
    error_drop: float | None
    t_value: float | None
    p_value: float | None
    significant: bool
    evidence: str
    equivalent: list[str] = Field(description="Effects that this data cannot tell apart from it")
    separability: float | None = Field(description="Share of its column that is left after the model")
    shape_parameters: Annotated[dict[str, float], SourcePath("choice.shape")]
    runs: Annotated[list[str], SourcePath("choice.runs")] = Field(
        default=[], description="Labels of the runs that it is in; none: in all of them"
    )


class ChangedValue(ViewModel):
    """A number that is another one since."""

    parameter: str
    value: float = Field(description="The difference")
    unit: str
    interval: Annotated[tuple[float | None, float | None], SourcePath(null=(-inf, inf))] = Field(
        description="Holds the true difference in 95 of 100 cases"
    )
    before: float | None = Field(default=None, description="What it was, where the model has it")


class Change(ChangedValue):
    """What the later measurements have and the baseline has not."""

    effect: Annotated[str, SourcePath("choice.effect")]
    joints: Annotated[list[str], SourcePath("choice.joints")] = Field(
        description="Of a mass: the joint of the link that carries it"
    )
    shape_parameters: Annotated[dict[str, float], SourcePath("choice.shape")] = Field(default={})
    runs: Annotated[list[str], SourcePath("choice.runs")] = Field(
        default=[], description="The later runs, that have it"
    )
    p_value: float | None
    evidence: str
    equivalent: list[str] = Field(default=[], description="Effects, or joints, that this data cannot tell from it")
    more: list[ChangedValue] = Field(default=[], description="Its other parameters")


class FrictionDifference(ViewModel):
    """How much more of a joint's torque goes into friction in the later measurements, a finding or not."""

    joint: str
    speed: float = Field(description="Its mean speed there, rad/s or m/s, at which the others are")
    value: float = Field(description="The difference")
    interval: Annotated[tuple[float | None, float | None], SourcePath(null=(-inf, inf))] = Field(
        description="Holds the true difference in 95 of 100 cases"
    )
    unit: str
    before: float = Field(description="What it would have been without the difference")


class UnknownPattern(ViewModel):
    """A dependence of the residual that no effect of the catalogue explains."""

    joint: str
    variable: Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]
    share: float | None


class NotVisible(ViewModel):
    """An effect that this data could not have shown."""

    effect: str
    joints: list[str]
    reason: str


class FailureSpot(ViewModel):
    """Where a joint's residual is large over one variable."""

    joint: str
    variable: str
    unit: str
    low: float
    high: float
    rms: float
    ratio: float | None


class Separation(ViewModel):
    """How well an effect can be told from all else that may explain the same residual."""

    parameter: str = Field(description="The one that comes out best")
    unit: str
    share: float = Field(description="What is left of its column beside the model and the rival")
    standard_deviation: Annotated[float | None, SourcePath(null=inf)] = Field(
        description="null where nothing determines it"
    )
    t_value: float | None = Field(description="The amplitude found so far over it; null where none is known")


class NextExperiment(ViewModel):
    """The experiment that would tell more."""

    reason: str
    design: dict[str, Any] = Field(description="A body for POST /v1/designs")
    present_separation: Separation | None = Field(default=None, description="By the data at hand")
    expected_separation: Separation | None = Field(
        default=None, description="By the data at hand and this experiment; null where it is not in the motion alone"
    )
    instructions: list[str] = Field(default=[], description="What people have to do beside running it")


class DiagnosisResult(ViewModel):
    """What is missing in a model."""

    verdict: Literal["adequate", "missing_effect", "unexplained"]
    summary: str
    noise_floor: list[float | None]
    residual_rms: list[float | None]
    candidates: list[Candidate]
    recommended: list[EffectChoice]
    unknown: list[UnknownPattern]
    not_visible: list[NotVisible]
    failure_map: list[FailureSpot]
    next_experiment: NextExperiment | None
    changes: list[Change] | None = Field(
        default=None, description="What differs from the baseline; empty: nothing; null: there was none"
    )
    friction: list[FrictionDifference] = Field(
        default=[], description="By how much that of each joint that moves differs from the baseline's, changed or not"
    )


class Evidence(ViewModel):
    """A joint's residual beside a ranked effect, in bins that hold about equally many samples."""

    rank: int
    effect: str
    joint: str
    joints: list[str] = Field(
        description="Joints for which there is such a figure, the one that it explains most first"
    )
    effort_unit: str
    variable: Literal["position", "velocity", "acceleration", "load", "time", "travel since reversal", "phase"] = Field(
        description="What the effect depends on most plainly"
    )
    variable_unit: Annotated[str, SourcePath("unit")]
    x: list[float] = Field(description="Mean of the variable in each bin")
    residual: list[float] = Field(description="Mean residual of the model without the effect")
    spread: list[float] = Field(description="Standard deviation of the residual in the bin")
    fitted: list[float] = Field(
        description="Mean of what the effect changes in the prediction, all parameters fitted anew"
    )
    count: list[int]
    explained: float | None = Field(description="Share of the residual's squares on this joint that the effect takes")


class DiagnosisView(Computed[DiagnosisRequest, DiagnosisResult]):
    """A diagnosis."""


class Day(NamedRequest):
    """The measurements of one day; without a name that of the first of them."""

    measurement_ids: Annotated[list[Identifier], Field(min_length=1, max_length=100)]


class SeriesRequest(NamedRequest):
    """Which robot is followed over which days."""

    identification_id: Identifier
    days: list[Day] = Field(min_length=1, max_length=1000, description="In their order; two at least with those before")
    continues: Identifier | None = Field(
        default=None, description="A series of the same model whose days come first; they are not read again."
    )


class SeriesChange(Change):
    """What differs from some day on; `runs` are the days that have it."""

    since: str = Field(description="The first day that has it")
    earliest: str = Field(description="From here on it would explain as much")
    latest: str = Field(description="Up to here")


class Course(ViewModel):
    """One parameter day by day; null where the motion of that day does not determine it."""

    parameter: str
    effect: str
    joint: str
    unit: str
    values: list[float | None]
    lower: list[float | None] = Field(description="Ends of the intervals that hold the true value in 95 of 100 cases")
    upper: list[float | None]
    varies: bool = Field(
        description="Of what a robot's days may differ in: all else is then known from the other days, too"
    )


class SeriesResult(ViewModel):
    """What has changed over the days, since when, and the course of every parameter."""

    summary: str
    days: list[str]
    changes: list[SeriesChange]
    missing: list[EffectChoice] = Field(description="What the model lacks on all days")
    courses: list[Course]


class SeriesView(Computed[SeriesRequest, SeriesResult]):
    """A series of days."""
