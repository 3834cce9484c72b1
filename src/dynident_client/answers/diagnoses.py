"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

from dynident_client.answers.shared_answers import EffectChoice


class Candidate(TypedDict):
    """A family of effects with its best joints and shape constants."""

    effect: str
    equivalent: list[str]
    """Effects that these data cannot distinguish from it"""
    error_after: float | None
    error_before: float | None
    error_drop: float | None
    evidence: str
    joints: list[str]
    p_value: float | None
    question: str
    """Whether the robot has the part that the effect is of"""
    rank: int
    reason: Reason | None
    """Why it is a finding or not"""
    runs: list[str]
    """Labels of the runs in which it acts; empty: in all of them"""
    separability: float | None
    """Share of its column that the model does not explain"""
    shape_parameters: dict[str, float]
    significant: bool
    t_value: float | None
    title: str
    """The effect in words: while there is a question, what the data show"""


class Change(TypedDict):
    """A change of the later measurements from the baseline."""

    before: float | None
    """The earlier value, if the model has it"""
    effect: str
    equivalent: list[str]
    """Effects or joints that these data cannot distinguish from it"""
    evidence: str
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    joints: list[str]
    """For a mass: the joint of the link that carries it"""
    more: list[ChangedValue]
    """Its other parameters"""
    p_value: float | None
    parameter: str
    runs: list[str]
    """The later runs that show it"""
    shape_parameters: dict[str, float]
    unit: str
    value: float
    """The difference"""


class ChangedValue(TypedDict):
    """A value that has changed."""

    before: float | None
    """The earlier value, if the model has it"""
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    parameter: str
    unit: str
    value: float
    """The difference"""


class Conclusion(TypedDict):
    """What a diagnosis says in all, and the one next thing to do."""

    code: Literal["something_is_missing", "nothing_above_limits", "cannot_tell"]
    headline: str
    next_step: str
    why: list[str]
    """What it rests on"""


class Course(TypedDict):
    """One parameter day by day; null if the motion of that day does not determine it."""

    effect: str
    joint: str
    lower: list[float | None]
    """Ends of the intervals that hold the true value in 95 of 100 cases"""
    parameter: str
    unit: str
    upper: list[float | None]
    values: list[float | None]
    varies: bool
    """Whether this parameter may differ from day to day; all others are also known from the other days"""


class DetectionLimit(TypedDict):
    """The size of an effect on a joint that these recordings would have shown."""

    effect: str
    half_size: float | None
    """The same with 50 %; null if none would"""
    joints: list[str]
    """Empty for an effect of the whole robot"""
    parameter: str
    """The parameter that tells how large the effect is"""
    shape_parameters: dict[str, float]
    """Shape constants that the sizes are of: the nearest to the usual ones that show"""
    share: float | None
    """`size` over `usual`"""
    size: float | None
    """Smallest size that would have been accepted with 95 %; null if none would"""
    unit: str
    usual: float
    """Size on arms that have the effect"""


class DiagnosisResult(TypedDict):
    """What is missing in a model."""

    candidates: list[Candidate]
    changes: list[Change] | None
    """Differences from the baseline; empty: none; null: there was no baseline"""
    conclusion: Conclusion | None
    """What all this says, and the next thing to do"""
    detection_limits: list[DetectionLimit]
    """The size of each effect on each joint that these recordings would have shown"""
    failure_map: list[FailureSpot]
    friction: list[FrictionDifference]
    """Change of the friction of each moving joint from the baseline, significant or not"""
    next_experiment: NextExperiment | None
    noise_floor: list[float | None]
    not_visible: list[NotVisible]
    outcomes: list[Outcome]
    """What became of every effect on every joint, and why; findings first"""
    questions: list[str]
    """Questions that recommended effects depend on, each once"""
    recommended: list[RecommendedEffect]
    residual_rms: list[float | None]
    summary: str
    unknown: list[UnknownPattern]
    verdict: Literal["adequate", "missing_effect", "unexplained"]


class Evidence(TypedDict):
    """Residual of a joint over the variable of a ranked effect, in bins with about equally many samples."""

    count: list[int]
    effect: str
    effort_unit: str
    error_drop: float | None
    """What the effect explains, as in the ranking: share of the held-out error of its joints that it removes beside
    everything that ranks above"""
    explained: float | None
    """Share of the squared residual of this joint that the curve removes where it was fitted, beside the model alone"""
    fitted: list[float]
    """Mean change of the prediction by the effect, with all parameters fitted again"""
    joint: str
    joints: list[str]
    """Joints for which there is such a figure; first the joint that the effect explains most"""
    rank: int
    residual: list[float]
    """Mean residual of the model without the effect"""
    spread: list[float]
    """Standard deviation of the residual in the bin"""
    variable: Literal["position", "velocity", "acceleration", "load", "time", "travel since reversal", "phase"]
    """The variable on which the effect depends most clearly"""
    variable_unit: str
    x: list[float]
    """Mean of the variable in each bin"""


class FailureSpot(TypedDict):
    """A range of one variable in which a joint's residual is large."""

    high: float
    joint: str
    low: float
    ratio: float | None
    rms: float
    unit: str
    variable: str


class FrictionDifference(TypedDict):
    """Change of a joint's friction torque from the baseline to the later measurements, significant or not."""

    before: float
    """The value without the difference"""
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    joint: str
    speed: float
    """Mean speed of the joint, rad/s or m/s, at which the values are compared"""
    unit: str
    value: float
    """The difference"""


class NextExperiment(TypedDict):
    """The experiment that would show more."""

    design: dict[str, Any]
    """Request body for POST /v1/designs"""
    expected_separation: Separation | None
    """From the existing data and this experiment; null if it does not depend on the motion alone"""
    instructions: list[str]
    """What people must do besides running the experiment"""
    present_separation: Separation | None
    """From the existing data"""
    reason: str


class NotVisible(TypedDict):
    """An effect that these data could not show."""

    effect: str
    joints: list[str]
    reason: str


class Outcome(TypedDict):
    """What became of an effect on some joints."""

    effect: str
    error_drop: float | None
    """Share of the held-out error that it removes beside all findings"""
    joints: list[str]
    reason: Reason
    runs: list[str]
    shape_parameters: dict[str, float]


class Reason(TypedDict):
    """Why a candidate is a finding or not."""

    brief: str
    """The reason in a few words"""
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
        "cannot_be_added",
        "most_effects",
        "undetermined_model",
        "passed_over",
        "not_tried",
    ]
    step: int | None
    """Rank of the finding that it refers to; of a finding its own"""
    text: str
    """The reason as a sentence"""
    values: dict[str, float | str | None]
    """Numbers and names that belong to the code"""


class RecommendedEffect(TypedDict):
    """An effect to add to the model."""

    effect: str
    """An id from GET /v1/effects"""
    joints: list[str]
    """Names of joints; by default, all joints that the effect can act on."""
    question: str
    """Whether the robot has the part that the effect is of; answer with has or has_not of the robot. Empty if that is
    known, or there is no such part"""
    runs: list[str]
    """Names of the measurements, or labels of their runs, in which the effect acts"""
    shape_parameters: dict[str, float]
    """Shape constants; searched for if not given."""


class Separation(TypedDict):
    """How well an effect can be distinguished from other explanations of the same residual."""

    parameter: str
    """The parameter that is determined best"""
    share: float
    """Share of its column that the model and the rival do not explain"""
    standard_deviation: float | None
    """null if nothing determines it"""
    t_value: float | None
    """The amplitude found so far divided by the standard deviation; null if none is known"""
    unit: str


class SeriesChange(TypedDict):
    """A difference from some day on; `runs` are the days that have it."""

    before: float | None
    """The earlier value, if the model has it"""
    earliest: str
    """First day from which on it explains the data about equally well"""
    effect: str
    equivalent: list[str]
    """Effects or joints that these data cannot distinguish from it"""
    evidence: str
    interval: tuple[float | None, float | None]
    """Holds the true difference in 95 of 100 cases"""
    joints: list[str]
    """For a mass: the joint of the link that carries it"""
    latest: str
    """Last such day"""
    more: list[ChangedValue]
    """Its other parameters"""
    p_value: float | None
    parameter: str
    runs: list[str]
    """The later runs that show it"""
    shape_parameters: dict[str, float]
    since: str
    """The first day that has it"""
    unit: str
    value: float
    """The difference"""


class SeriesResult(TypedDict):
    """What has changed over the days, since when, and every parameter over the days."""

    changes: list[SeriesChange]
    courses: list[Course]
    days: list[str]
    missing: list[EffectChoice]
    """Effects that the model lacks on all days"""
    summary: str


class UnknownPattern(TypedDict):
    """A dependence of the residual that no effect of the catalogue explains."""

    joint: str
    share: float | None
    variable: Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]
