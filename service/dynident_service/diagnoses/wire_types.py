"""Bodies and answers of diagnoses and series."""

from __future__ import annotations

from math import inf
from typing import Annotated, Any, Literal

from pydantic import Field, computed_field

from dynident.diagnosis.diagnosis_request import DiagnosisChoices
from dynident_service.shared.request_bodies import derive_body
from dynident_service.shared.wire_types import (
    Computed,
    EffectChoice,
    Identifier,
    NamedRequest,
    SourcePath,
    ViewModel,
    WithTables,
)


@derive_body(DiagnosisChoices, or_null=("max_effects",))
class DiagnosisRequest(NamedRequest):
    """The model to diagnose, and the measurements to use."""

    identification_id: Identifier
    measurement_ids: list[Identifier] | None = Field(
        default=None, min_length=1, max_length=100, description="By default, those that the model was identified from."
    )
    baseline_ids: list[Identifier] = Field(
        default=[],
        max_length=100,
        description="Earlier measurements of the same robot: the diagnosis then reports what has changed since.",
    )


class Reason(ViewModel):
    """Why a candidate is a finding or not."""

    code: Literal[
        "accepted",
        "equivalent",
        "explained",
        "not_significant",
        "too_small",
        "not_determined",
        "impossible",
        "unstable",
        "only_at_reversals",
        "superfluous",
        "not_resolved",
        "harmful",
        "misnamed",
        "no_help_once_added",
        "not_confirmed",
        "cannot_be_added",
        "most_effects",
        "undetermined_model",
        "passed_over",
        "not_tried",
    ]
    step: int | None = Field(description="Rank of the finding that it refers to; for a finding, its own rank")
    values: dict[str, float | str | None] = Field(description="Numbers and names that belong to the code")
    brief: str = Field(description="The reason in a few words")
    text: str = Field(description="The reason as a sentence")


class ReasonOfCandidate(ViewModel):
    """Why a candidate is a finding or not, in short."""

    code: str
    values: dict[str, float | str | None] = Field(description="Numbers and names that belong to the code")
    detail: str = Field(description="The reason as a sentence")


class Outcome(ViewModel):
    """What became of an effect on some joints."""

    effect: Annotated[str, SourcePath("choice.effect")]
    joints: Annotated[list[str], SourcePath("choice.joints")]
    shape_parameters: Annotated[dict[str, float], SourcePath("choice.shape")] = Field(default={})
    runs: Annotated[list[str], SourcePath("choice.runs")] = Field(default=[])
    error_drop: float | None = Field(
        description="Share of the error on blocks left out of the fit that it removes in addition to all findings"
    )
    reason: Reason


class Candidate(ViewModel):
    """A family of effects with its best joints and shape constants.

    Errors are relative, on blocks left out of the fit, of these joints, after everything that ranks above was added.
    """

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
    equivalent: list[str] = Field(description="Effects that these data cannot distinguish from it")
    separability: float | None = Field(description="Share of its column that the model does not explain")
    shape_parameters: Annotated[dict[str, float], SourcePath("choice.shape")]
    runs: Annotated[list[str], SourcePath("choice.runs")] = Field(
        default=[], description="Labels of the runs in which it acts; empty: in all of them"
    )
    reason: Reason | None = Field(default=None, description="Why it is a finding or not")
    title: str = Field(default="", description="The effect in words: while there is a question, what the data show")
    question: str = Field(default="", description="Whether the robot has the part that the effect is of")

    @computed_field  # type: ignore[prop-decorator]
    @property
    def reasons(self) -> list[ReasonOfCandidate]:
        """`reason` in a list; empty in diagnoses that an older version stored."""
        if self.reason is None:
            return []
        return [ReasonOfCandidate(code=self.reason.code, values=self.reason.values, detail=self.reason.text)]


class ChangedValue(ViewModel):
    """A value that has changed."""

    parameter: str
    value: float = Field(description="The difference")
    unit: str
    interval: Annotated[tuple[float | None, float | None], SourcePath(null=(-inf, inf))] = Field(
        description="Holds the true difference in 95 of 100 cases"
    )
    before: float | None = Field(default=None, description="The earlier value, if the model has it")


class Change(ChangedValue):
    """A change of the later measurements from the baseline."""

    effect: Annotated[str, SourcePath("choice.effect")]
    joints: Annotated[list[str], SourcePath("choice.joints")] = Field(
        description="For a mass: the joint of the link that carries it"
    )
    shape_parameters: Annotated[dict[str, float], SourcePath("choice.shape")] = Field(default={})
    runs: Annotated[list[str], SourcePath("choice.runs")] = Field(default=[], description="The later runs that show it")
    p_value: float | None
    evidence: str
    equivalent: list[str] = Field(
        default=[], description="Effects or joints that these data cannot distinguish from it"
    )
    carrier: str = Field(
        default="", description="Name of the link that it is on, where that is a floating base; else empty"
    )
    more: list[ChangedValue] = Field(default=[], description="Its other parameters")


class FrictionDifference(ViewModel):
    """Change of a joint's friction torque from the baseline to the later measurements, significant or not."""

    joint: str
    speed: float = Field(description="Mean speed of the joint, rad/s or m/s, at which the values are compared")
    value: float = Field(description="The difference")
    interval: Annotated[tuple[float | None, float | None], SourcePath(null=(-inf, inf))] = Field(
        description="Holds the true difference in 95 of 100 cases"
    )
    unit: str
    before: float = Field(description="The value without the difference")


class UnknownPattern(ViewModel):
    """A dependence of the residual that no effect of the catalogue explains."""

    joint: str
    variable: Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]
    share: float | None
    cause: str = Field(default="", description="What looks like this, a sensor that drifts or a coupled drive")


class NotVisible(ViewModel):
    """An effect that these data could not show."""

    effect: str
    joints: list[str]
    reason: str
    brief: str = Field(default="", description="The reason in a few words, for a table")


class DetectionLimit(ViewModel):
    """The size of an effect on a joint that these recordings would have shown."""

    effect: str
    joints: list[str] = Field(description="Empty for an effect of the whole robot")
    parameter: str = Field(description="The parameter that tells how large the effect is")
    unit: str
    size: Annotated[float | None, SourcePath(null=inf)] = Field(
        description="Smallest size that would have been accepted with 95 %; null if none would"
    )
    half_size: Annotated[float | None, SourcePath(null=inf)] = Field(
        description="The same with 50 %; null if none would"
    )
    usual: float = Field(description="Size on arms that have the effect")
    shape_parameters: Annotated[dict[str, float], SourcePath("shape")] = Field(
        default={}, description="Shape constants that the sizes are of: the nearest to the usual ones that show"
    )
    share: Annotated[float | None, SourcePath(null=inf)] = Field(description="`size` over `usual`")


class DetectionLimitOfJoint(ViewModel):
    """A detection limit in one row."""

    effect: str
    joint: str | None = Field(description="null for an effect of the whole robot")
    parameter: str = Field(description="The parameter that tells how large the effect is")
    limit: Annotated[float | None, SourcePath("size")] = Field(
        description="Smallest size that these recordings would have shown in 95 of 100 cases; null if none"
    )
    unit: str
    of_usual: Annotated[float | None, SourcePath("share")] = Field(
        description="The limit over the size on arms that have the effect; null if none would have shown"
    )


class Conclusion(ViewModel):
    """What a diagnosis says in all, and the one next thing to do."""

    code: Literal["something_is_missing", "nothing_above_limits", "cannot_tell"]
    headline: str
    why: list[str] = Field(description="What it rests on")
    next_step: str
    next_action: Literal["extend", "add_own_effect", "validate", "record"] | None = Field(
        default=None, description="`next_step` as a code; null in a diagnosis of an earlier version"
    )


class FailureSpot(ViewModel):
    """A range of one variable in which a joint's residual is large."""

    joint: str
    variable: str
    unit: str
    low: float
    high: float
    rms: float
    ratio: float | None


class Separation(ViewModel):
    """How well an effect can be distinguished from other explanations of the same residual."""

    parameter: str = Field(description="The parameter that is determined best")
    unit: str
    share: float = Field(description="Share of its column that the model and the rival do not explain")
    standard_deviation: Annotated[float | None, SourcePath(null=inf)] = Field(
        description="null if nothing determines it"
    )
    t_value: float | None = Field(
        description="The amplitude found so far divided by the standard deviation; null if none is known"
    )


class NextExperiment(ViewModel):
    """The experiment that would show more."""

    reason: str
    design: dict[str, Any] = Field(description="Request body for POST /v1/designs")
    present_separation: Separation | None = Field(default=None, description="From the existing data")
    expected_separation: Separation | None = Field(
        default=None,
        description="From the existing data and this experiment; null if it does not depend on the motion alone",
    )
    instructions: list[str] = Field(default=[], description="What people must do besides running the experiment")


class Doubt(ViewModel):
    """A question that a motion could decide: an effect, and those that the data cannot tell from it."""

    suspect: EffectChoice
    rivals: list[EffectChoice] = Field(description="Empty: is the effect present at all?")
    beside: list[EffectChoice] = Field(description="Effects that are in the model while the question is decided")


class NextExperimentRequest(NamedRequest):
    """The diagnosis whose questions a motion should decide."""

    diagnosis_id: Identifier


class NextExperimentResult(ViewModel):
    """The experiment that would show more."""

    experiment: NextExperiment | None = Field(description="null: no motion within the robot's limits decides anything")


class NextExperimentView(Computed[NextExperimentRequest, NextExperimentResult]):
    """The search for the experiment that would show more."""


class RecommendedEffect(EffectChoice):
    """An effect to add to the model."""

    question: str = Field(
        default="",
        description="Whether the robot has the part that the effect is of; answer with has or has_not of the robot. "
        "Empty if that is known, or there is no such part",
    )


class DiagnosisResult(ViewModel):
    """What is missing in a model."""

    verdict: Literal["adequate", "missing_effect", "unexplained", "cannot_tell"]
    summary: str
    noise_floor: list[float | None]
    residual_rms: list[float | None]
    candidates: list[Candidate]
    recommended: list[RecommendedEffect]
    questions: list[str] = Field(default=[], description="Questions that recommended effects depend on, each once")
    unknown: list[UnknownPattern]
    not_visible: list[NotVisible]
    failure_map: list[FailureSpot]
    next_experiment: NextExperiment | None = Field(
        description="null until POST /v1/diagnoses/{id}/next_experiment has found one, and in lists"
    )
    doubts: list[Doubt] = Field(
        default=[], description="What is open, most important first; a next experiment might decide it"
    )
    changes: list[Change] | None = Field(
        default=None, description="Differences from the baseline; empty: none; null: there was no baseline"
    )
    friction: list[FrictionDifference] = Field(
        default=[], description="Change of the friction of each moving joint from the baseline, significant or not"
    )
    outcomes: list[Outcome] = Field(
        default=[], description="What became of every effect on every joint, and why; findings first"
    )
    detection_limits: list[DetectionLimit] = Field(
        default=[],
        description="The size of each effect on each joint that these recordings would have shown; with a baseline, "
        "only of effects that arms often have",
    )
    conclusion: Conclusion | None = Field(default=None, description="What all this says, and the next thing to do")


class Evidence(ViewModel):
    """Residual of a joint over the variable of a ranked effect, in bins with about equally many samples."""

    rank: int
    effect: str
    joint: str
    joints: list[str] = Field(
        description="Joints for which there is such a figure; first the joint that the effect explains most"
    )
    effort_unit: str
    variable: Literal["position", "velocity", "acceleration", "load", "time", "travel since reversal", "phase"] = Field(
        description="The variable on which the effect depends most clearly"
    )
    variable_unit: Annotated[str, SourcePath("unit")]
    x: list[float] = Field(description="Mean of the variable in each bin")
    residual: list[float] = Field(description="Mean residual of the model without the effect")
    spread: list[float] = Field(description="Standard deviation of the residual in the bin")
    fitted: list[float] = Field(
        description="Mean change of the prediction by the effect, with all parameters fitted again"
    )
    count: list[int]
    explained: float | None = Field(
        description="Share of the squared residual of this joint that the curve removes where it was fitted, when "
        "it is added to the model alone"
    )
    error_drop: float | None = Field(
        default=None,
        description="What the effect explains, as in the ranking: share of the error of its joints on left-out blocks "
        "that it removes after everything that ranks above it",
    )


class DiagnosisView(Computed[DiagnosisRequest, DiagnosisResult], WithTables):
    """A diagnosis."""


class Day(NamedRequest):
    """The measurements of one day; by default named after the first of them."""

    measurement_ids: Annotated[list[Identifier], Field(min_length=1, max_length=100)]


class SeriesRequest(NamedRequest):
    """The robot to follow, and the days."""

    identification_id: Identifier
    days: list[Day] = Field(
        min_length=1, max_length=1000, description="In order; at least two, including those of `continues`"
    )
    continues: Identifier | None = Field(
        default=None, description="A series of the same model whose days come first; they are not read again."
    )


class SeriesChange(Change):
    """A difference from some day on; `runs` are the days that have it."""

    since: str = Field(description="The first day that has it")
    earliest: str = Field(description="First day from which on it explains the data about equally well")
    latest: str = Field(description="Last such day")


class Course(ViewModel):
    """One parameter day by day; null if the motion of that day does not determine it."""

    parameter: str
    effect: str
    joint: str
    unit: str
    values: list[float | None]
    lower: list[float | None] = Field(description="Ends of the intervals that hold the true value in 95 of 100 cases")
    upper: list[float | None]
    varies: bool = Field(
        description="Whether this parameter may differ from day to day; all others are also known from the other days"
    )


class SeriesResult(ViewModel):
    """What has changed over the days, since when, and every parameter over the days."""

    summary: str
    days: list[str]
    changes: list[SeriesChange]
    missing: list[EffectChoice] = Field(description="Effects that the model lacks on all days")
    courses: list[Course]


class SeriesView(Computed[SeriesRequest, SeriesResult], WithTables):
    """A series of days."""
