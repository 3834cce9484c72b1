"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

from dynident_client.answers.parts import EffectChoice


class Candidate(TypedDict):
    """One family of effects, at its best place and shape; errors are relative, held out, on the joints named."""

    effect: str
    equivalent: list[str]
    """Effects that this data cannot tell apart from it"""
    error_after: float | None
    error_before: float | None
    error_drop: float | None
    evidence: str
    joints: list[str]
    p_value: float | None
    rank: int
    runs: list[str]
    """Labels of the runs that it is in; none: in all of them"""
    separability: float | None
    """Share of its column that is left after the model"""
    shape_parameters: dict[str, float]
    significant: bool
    t_value: float | None


class Change(TypedDict):
    """What the later measurements have and the baseline has not."""

    before: float | None
    """What it was, where the model has it"""
    effect: str
    equivalent: list[str]
    """Effects, or joints, that this data cannot tell from it"""
    evidence: str
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    joints: list[str]
    """Of a mass: the joint of the link that carries it"""
    more: list[ChangedValue]
    """Its other parameters"""
    p_value: float | None
    parameter: str
    runs: list[str]
    """The later runs, that have it"""
    shape_parameters: dict[str, float]
    unit: str
    value: float
    """The difference"""


class ChangedValue(TypedDict):
    """A number that is another one since."""

    before: float | None
    """What it was, where the model has it"""
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    parameter: str
    unit: str
    value: float
    """The difference"""


class Course(TypedDict):
    """One parameter day by day; null where the motion of that day does not determine it."""

    effect: str
    joint: str
    lower: list[float | None]
    """Ends of the intervals that hold the true value in 95 of 100 cases"""
    parameter: str
    unit: str
    upper: list[float | None]
    values: list[float | None]
    varies: bool
    """Of what a robot's days may differ in: all else is then known from the other days, too"""


class DiagnosisResult(TypedDict):
    """What is missing in a model."""

    candidates: list[Candidate]
    changes: list[Change] | None
    """What differs from the baseline; empty: nothing; null: there was none"""
    failure_map: list[FailureSpot]
    friction: list[FrictionDifference]
    """By how much that of each joint that moves differs from the baseline's, changed or not"""
    next_experiment: NextExperiment | None
    noise_floor: list[float | None]
    not_visible: list[NotVisible]
    recommended: list[EffectChoice]
    residual_rms: list[float | None]
    summary: str
    unknown: list[UnknownPattern]
    verdict: Literal["adequate", "missing_effect", "unexplained"]


class Evidence(TypedDict):
    """A joint's residual beside a ranked effect, in bins that hold about equally many samples."""

    count: list[int]
    effect: str
    effort_unit: str
    explained: float | None
    """Share of the residual's squares on this joint that the effect takes"""
    fitted: list[float]
    """Mean of what the effect changes in the prediction, all parameters fitted anew"""
    joint: str
    joints: list[str]
    """Joints for which there is such a figure, the one that it explains most first"""
    rank: int
    residual: list[float]
    """Mean residual of the model without the effect"""
    spread: list[float]
    """Standard deviation of the residual in the bin"""
    variable: Literal["position", "velocity", "acceleration", "load", "time", "travel since reversal", "phase"]
    """What the effect depends on most plainly"""
    variable_unit: str
    x: list[float]
    """Mean of the variable in each bin"""


class FailureSpot(TypedDict):
    """Where a joint's residual is large over one variable."""

    high: float
    joint: str
    low: float
    ratio: float | None
    rms: float
    unit: str
    variable: str


class FrictionDifference(TypedDict):
    """How much more of a joint's torque goes into friction in the later measurements, a finding or not."""

    before: float
    """What it would have been without the difference"""
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    joint: str
    speed: float
    """Its mean speed there, rad/s or m/s, at which the others are"""
    unit: str
    value: float
    """The difference"""


class NextExperiment(TypedDict):
    """The experiment that would tell more."""

    design: dict[str, Any]
    """A body for POST /v1/designs"""
    expected_separation: Separation | None
    """By the data at hand and this experiment; null where it is not in the motion alone"""
    instructions: list[str]
    """What people have to do beside running it"""
    present_separation: Separation | None
    """By the data at hand"""
    reason: str


class NotVisible(TypedDict):
    """An effect that this data could not have shown."""

    effect: str
    joints: list[str]
    reason: str


class Separation(TypedDict):
    """How well an effect can be told from all else that may explain the same residual."""

    parameter: str
    """The one that comes out best"""
    share: float
    """What is left of its column beside the model and the rival"""
    standard_deviation: float | None
    """null where nothing determines it"""
    t_value: float | None
    """The amplitude found so far over it; null where none is known"""
    unit: str


class SeriesChange(TypedDict):
    """What differs from some day on; `runs` are the days that have it."""

    before: float | None
    """What it was, where the model has it"""
    earliest: str
    """From here on it would explain as much"""
    effect: str
    equivalent: list[str]
    """Effects, or joints, that this data cannot tell from it"""
    evidence: str
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    joints: list[str]
    """Of a mass: the joint of the link that carries it"""
    latest: str
    """Up to here"""
    more: list[ChangedValue]
    """Its other parameters"""
    p_value: float | None
    parameter: str
    runs: list[str]
    """The later runs, that have it"""
    shape_parameters: dict[str, float]
    since: str
    """The first day that has it"""
    unit: str
    value: float
    """The difference"""


class SeriesResult(TypedDict):
    """What has changed over the days, since when, and the course of every parameter."""

    changes: list[SeriesChange]
    courses: list[Course]
    days: list[str]
    missing: list[EffectChoice]
    """What the model lacks on all days"""
    summary: str


class UnknownPattern(TypedDict):
    """A dependence of the residual that no effect of the catalogue explains."""

    joint: str
    share: float | None
    variable: Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]
