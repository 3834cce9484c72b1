"""Bodies and answers of identifications, their extensions and verdicts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from dynident.effects.effect_choices import DEFAULT_EFFECTS, OFFSETS
from dynident.export.export_request import ExportChoices
from dynident.identification.identification_choices import EssentialChoices, IdentificationChoices
from dynident.recordings.recording_metadata import Filters
from dynident_service.campaigns.wire_types import CampaignOutcome
from dynident_service.measurements.wire_types import RevisionRequest, SeenMeasurement
from dynident_service.problems import RemedyView
from dynident_service.shared.request_bodies import derive_body, derive_query
from dynident_service.shared.wire_types import (
    Computed,
    ContactDetectionView,
    DriftView,
    EffectChoice,
    ErrorsView,
    Identifier,
    Labelled,
    NamedRequest,
    RequestModel,
    SourcePath,
    Table,
    UsedPreprocessing,
    ViewModel,
    WithTables,
)

JUDGEMENTS = Literal["determined", "uncertain", "zero_in_interval", "held"]
SHAPE_JUDGEMENTS = Literal[
    "determined", "uncertain", "not_determined", "at_edge", "elsewhere", "chosen", "not_looked_at"
]

if TYPE_CHECKING:
    EssentialQuery = EssentialChoices
    ExportQuery = ExportChoices
else:
    EssentialQuery = derive_query(EssentialChoices)
    ExportQuery = derive_query(ExportChoices)


@derive_body(Filters)
class Preprocessing(RequestModel):
    """Cut-off frequencies in Hz (null: no filter) and decimation; missing values are chosen from the data."""


MOST_RECORDINGS = 100
"""Recordings that a model may be identified from."""


@derive_body(IdentificationChoices, "tolerance")
class IdentificationRequest(NamedRequest):
    """What to identify, from which measurements, and how."""

    robot_id: Identifier
    measurement_ids: Annotated[list[Identifier], Field(min_length=1, max_length=MOST_RECORDINGS)]
    validation_ids: list[Identifier] = Field(default=[], max_length=MOST_RECORDINGS)
    effects: list[EffectChoice] = Field(
        default=[EffectChoice(effect=effect.effect) for effect in DEFAULT_EFFECTS],
        min_length=1,
        max_length=200,
        # The torque of a real robot has offsets: its recordings are predicted better with them.
        examples=[[{"effect": effect.effect} for effect in (*DEFAULT_EFFECTS, OFFSETS)]],
        description="What acts on the joints. The example is right for real robots: their torque has offsets",
    )
    preprocessing: Preprocessing | Literal["auto"] = "auto"


class ExtensionRequest(NamedRequest):
    """Effects to add to an identified model."""

    effects: list[EffectChoice] = Field(min_length=1, max_length=200)


class RemovalRequest(NamedRequest):
    """Effects to remove from an identified model."""

    effects: list[EffectChoice] = Field(
        min_length=1, max_length=200, description="Removed from the given joints; without joints, from all"
    )


class StoredIdentification(IdentificationRequest):
    """A request as it is stored, with the changes to the parent."""

    added: list[EffectChoice] = Field(default=[])
    removed: list[EffectChoice] = Field(default=[])


class ParameterView(ViewModel):
    """One base parameter."""

    name: str
    value: float
    unit: str
    standard_deviation: float | None
    relative_standard_deviation: float | None = Field(description="A fraction")
    well_identified: bool = Field(description="Whether the data determine it, by its judgement")
    judgement: JUDGEMENTS | None = Field(
        default=None,
        description="From its 95 % interval: determined (standard deviation at most a tenth of the value, and mainly "
        "from the data), uncertain, not distinguishable from zero, or held at a known value",
    )
    times_smallest: float | None = Field(
        default=None,
        description="Relative standard deviation divided by the smallest of all: above ten, poorly identified by §12.7",
    )
    effect: str
    link: str
    grouping: str = Field(description="As a sum of standard parameters")
    shape_parameters: Annotated[dict[str, float], SourcePath("shape")]
    interval: tuple[float | None, float | None] = Field(
        default=(None, None), description="Holds the true value in 95 of 100 cases"
    )
    essential: bool = Field(default=True, description="False: set to zero because it is not essential")


class ShapeConstantView(ViewModel):
    """A constant inside an effect's columns: a Stribeck velocity, a slip distance, the frequency of a ripple."""

    effect: str
    joints: list[str] = Field(description="Empty if the effect acts on the whole robot")
    name: str
    unit: str
    description: str
    value: float
    standard_deviation: float | None = Field(description="null if the uncertainty is unknown")
    interval: tuple[float, float] | None = Field(description="Holds the true value in 95 of 100 cases")
    judgement: SHAPE_JUDGEMENTS = Field(
        description="determined; uncertain; not_determined: the interval covers the whole search range; at the edge of "
        "that range; the data prefer a value outside it; chosen among a few kinds; not examined, without a "
        "recording"
    )
    note: str = Field(description="Why there is no interval, or what is unusual about it; otherwise empty")


ConfirmedBy = Annotated[
    list[Literal["moving", "reversing", "starting"]] | None,
    Field(
        description="Held-out rows on which what was added surely lowers the error: where joints move; at reversals "
        "and at starts of its joints, where the effect claims to explain these; [] if none do; null if not judged"
    ),
]


class StepView(ViewModel):
    """A model between the parent and this one; it has one effect more than the model before it."""

    added: Annotated[list[EffectChoice], SourcePath("step.added")]
    n_parameters: Annotated[int, SourcePath("model.n_parameters")]
    residual: Annotated[ErrorsView, SourcePath("fit")]
    validation: Annotated[ErrorsView | None, SourcePath("held_out")]
    confirmed_by: ConfirmedBy = None


class IdentificationResult(ViewModel):
    """An identified model."""

    parameters: list[ParameterView]
    shape_constants: list[ShapeConstantView] = Field(
        default=[],
        description="Uncertainty of the effects' shape constants, including the uncertainty of the other parameters",
    )
    residual: Annotated[ErrorsView, SourcePath("fit")]
    validation: Annotated[ErrorsView | None, SourcePath("held_out")]
    confirmed_by: ConfirmedBy = None
    copied: Annotated[list[str], SourcePath("data.copied")] = Field(
        default=[], description="Held-out measurements, by name, that contain samples of the fit"
    )
    converged: bool = Field(default=True, description="Whether the iterations of the estimator have converged")
    condition_number: float | None = Field(description="Of W [12.12]; parameters of other units change it")
    equilibrated_condition_number: float | None = Field(
        default=None,
        description="The same with rows over their noise and columns of unit norm; null in models that an older "
        "version stored",
    )
    condition_meaning: str = Field(default="", description="What the equilibrated condition number means")
    n_equations: int
    equations_per_parameter: float
    effective_rows: list[float] = Field(description="Effective number of independent samples of each joint's rows")
    inertia_matrix_positive_definite: bool
    effects: Annotated[list[EffectChoice], SourcePath("choices.effects")]
    preprocessing: UsedPreprocessing
    warnings: list[str]
    dependence: list[str] = Field(default=[], description="Parameters of which the motion determines only combinations")
    parent_id: str | None
    rungs: list[StepView] = Field(
        default=[], description="Models between the parent and this one: an extension makes one for every effect"
    )
    joints: Annotated[list[str], SourcePath("model.robot.joint_names")]
    effort_units: list[str]
    measurements: list[SeenMeasurement] = Field(
        default=[], description="Which revision of which file the model used; [] in models that an older version stored"
    )
    campaign: CampaignOutcome | None = Field(
        default=None, description="For a model of a campaign: what its last recordings brought, and the decision"
    )


class IdentificationView(Computed[IdentificationRequest, IdentificationResult], Labelled):
    """An identification."""

    robot_id: str
    parent_id: str | None
    added: list[EffectChoice] = Field(description="What was added to the parent.")
    removed: list[EffectChoice] = Field(description="What was removed from the parent.")


class EssentialStepView(ViewModel):
    """One step of the elimination: one parameter is removed."""

    name: str
    relative_standard_deviation: Annotated[float | None, SourcePath("relative_deviation")] = Field(
        description="Before it was removed, a fraction"
    )
    ratio: float | None = Field(description="The largest relative standard deviation divided by the smallest")
    p_value: float = Field(description="Probability that noise alone is as large as everything that is removed so far")
    residual: Annotated[ErrorsView, SourcePath("fit")]
    validation: Annotated[ErrorsView | None, SourcePath("held_out")]


class EssentialView(ViewModel):
    """The essential parameters of a model: those left by backward elimination."""

    reason: str = Field(description="Why the elimination stopped")
    essential: list[str]
    steps: list[EssentialStepView]
    parameters: list[ParameterView] = Field(description="Estimated again with the others at zero")
    residual: Annotated[ErrorsView, SourcePath("identification.fit")]
    validation: Annotated[ErrorsView | None, SourcePath("identification.held_out")]
    tables: list[Table] = Field(description="The steps and the parameters as tables for people")


class ExportView(ViewModel):
    """A format that a model can be written in."""

    format: str
    title: str
    contains: str = Field(description="What a file of the format holds")
    held_out_error: float | None = Field(
        description="Relative error of the torque on held-out data, where joints move, of a program that reads all of "
        "the file; null without such data, or if the file is no model of the torque"
    )
    notes: list[str] = Field(description="What the file cannot hold, and what that costs")
    refusal: str | None = Field(description="Why this model cannot be written so; null if it can")


class ExportsView(ViewModel):
    """The formats, and the error of the model itself."""

    items: list[ExportView]
    held_out_error: float | None


Rows = Annotated[
    list[Annotated[list[float], Field(fail_fast=True, max_length=200)]],
    Field(fail_fast=True, min_length=1, max_length=100_000),
]
"""[sample][joint]."""


class PredictionRequest(RequestModel):
    """States, or the samples of a motion in their order."""

    q: Rows = Field(description="rad or m, [sample][joint]")
    dq: Rows = Field(description="rad/s or m/s")
    ddq: Rows = Field(description="rad/s² or m/s²")
    t: list[float] | None = Field(
        default=None,
        max_length=100_000,
        fail_fast=True,
        description="Times of the samples in s, for effects that depend on them or on derivatives of the acceleration",
    )
    interval: float | None = Field(default=None, gt=0, lt=1, description="Probability of intervals, such as 0.95")
    steady: bool = Field(
        default=False,
        description="Whether each row stands for itself, with friction that slides steadily; otherwise hysteresis "
        "remembers the rows before",
    )


class PredictedTorqueView(ViewModel):
    """Predicted torque, [sample][joint] in N m or N; null for a joint whose torque was not recorded."""

    joints: list[str]
    torque: list[list[float | None]]
    lower: list[list[float | None]] | None = Field(
        default=None, description="Of what is measured; null without `interval`"
    )
    upper: list[list[float | None]] | None = None
    model_lower: list[list[float | None]] | None = Field(
        default=None, description="Interval of the model's own torque, from the covariance of its parameters"
    )
    model_upper: list[list[float | None]] | None = None


class CorrelationView(ViewModel):
    """How the estimates of the parameters depend on one another."""

    parameters: Annotated[list[str], SourcePath("names")]
    correlation: list[list[float | None]] = Field(description="Row by row, in the order of `parameters`")
    sentences: list[str] = Field(description="Parameters of which the motion determines only combinations, worst first")


class LadderStep(ViewModel):
    """One step of the ladder."""

    id: str
    part_of: str | None = Field(
        default=None,
        description="The identification that made this model as an intermediate step; null if the model is a resource "
        "itself",
    )
    name: str | None
    parent_id: str | None
    status: str
    added: Annotated[list[EffectChoice], SourcePath("step.added")]
    removed: Annotated[list[EffectChoice], SourcePath("step.removed")]
    effects: Annotated[list[EffectChoice], SourcePath("choices.effects")]
    n_parameters: Annotated[int | None, SourcePath("model.n_parameters")]
    residual: Annotated[ErrorsView | None, SourcePath("fit")]
    validation: Annotated[ErrorsView | None, SourcePath("held_out")]
    confirmed_by: ConfirmedBy = None
    change: str = Field(default="", description="What the step added and removed, in words")
    best: bool = Field(
        default=False,
        description="Whether it has the smallest validation error of the ladder where joints move "
        "(`validation.moving`). Less than 0.5 % of it is no difference, unless held-out data confirm what was added.",
    )
    rises: bool = Field(
        default=False,
        description="After the best step, with a larger validation error where joints move: the added effect makes the "
        "model worse",
    )


class LadderStepDifference(ViewModel):
    """The same step of two ladders: this ladder's error minus the other's; negative if this one is better."""

    rung: int = Field(description="Number of the step, from 1 for the first model")
    id: str | None = Field(description="null if this ladder has ended")
    against_id: str | None = Field(description="null if the other ladder has ended")
    n_parameters: int | None
    residual: list[float | None] | None = Field(description="Relative error per joint")
    residual_total: float | None
    validation: list[float | None] | None = Field(description="Relative held-out error per joint")
    validation_total: float | None
    residual_moving: list[float | None] | None = Field(default=None, description="Where each joint moves")
    residual_moving_total: float | None = None
    validation_moving: list[float | None] | None = Field(default=None, description="Where each joint moves")
    validation_moving_total: float | None = None


class StepSentence(ViewModel):
    """What the last step of a ladder did."""

    text: str = Field(description="Effects, errors before and after, joints that got worse")
    is_better: bool = Field(description="Whether it made nothing worse")


class Lineage(ViewModel):
    """The models that led to one, the first one first; if requested, compared with those that led to another."""

    items: list[LadderStep]
    against: list[LadderStep] | None = None
    common_ancestor: str | None = Field(default=None, description="The last model that both ladders contain")
    differences: list[LadderStepDifference] | None = None
    same_data: bool | None = Field(
        default=None, description="Whether all models of both ladders use the same measurements"
    )
    tables: list[Table] = Field(
        default=[],
        description="The ladder as tables for people: ladder, joints; if compared with another one, two_ladders",
    )
    last_step: StepSentence | None = Field(
        default=None, description="What the last model differs in from its parent; null for a first model"
    )


UseAction = Literal[
    "diagnose",
    "design",
    "identify_feasible",
    "check_gains",
    "identify_gains",
    "export_for_simulation",
    "export_for_feed_forward",
    "observe_momentum",
    "weigh_load",
]


class NextStepView(ViewModel):
    """One thing to do next."""

    sentence: str
    action: UseAction | None = Field(description="Which action of dynident does it; null where none does")


class UseView(ViewModel):
    """Whether the model is fit for a use."""

    use: Literal["simulation", "feed_forward", "collision_detection", "payload"]
    fit: bool | None = Field(
        description="Whether it may be used so, at least within the limit that the reason names; null: not judged"
    )
    state: Literal["yes", "limited", "no", "not_judged"] = Field(
        description="limited: fit within a limit; not_judged: there are no data to judge by"
    )
    test: str = Field(default="", description="What the use is judged by")
    values: dict[str, float] = Field(default={}, description="Numbers that the test gave, in SI units")
    reason: str
    next_step: str = Field(description="`sentence` of `next`")
    next_action: UseAction | None = Field(description="`action` of `next`")
    next: NextStepView


class DetectableForceView(ViewModel):
    """The smallest force at the tool that is detected with one false alarm per hour."""

    force: float = Field(description="N, in 95 % of the directions and postures of the held-out motion")
    thresholds: list[float | None] = Field(
        description="Thresholds for every joint's filtered residual, N m or N; null: the joint moves too seldom"
    )
    seconds: float = Field(description="Duration of the held-out motion that it was computed from")


class StopView(ViewModel):
    """The most probable cause of a large error."""

    cause: str
    measurement_id: str | None = Field(default=None, description="Place of the fault, as far as it is known")
    apply: RevisionRequest | None = Field(
        default=None, description="Correction: a body for POST /v1/measurements/{measurement_id}/revisions"
    )
    remedies: list[RemedyView] = Field(default=[], description="Those that the cause quotes")


class CommonView(ViewModel):
    """What held-out data have in common with the data of the fit."""

    held_out_id: str
    fitted_id: str
    kind: Literal["copied", "repeated"] = Field(description="The same samples, or the same motion once more")
    share: float = Field(description="Of the moving time, 0 to 1")
    detail: str


class VerdictView(WithTables):
    """What a model is fit for, and why or why not."""

    uses: list[UseView]
    held_out: ErrorsView | None = Field(description="The data that it was judged by; null without held-out data")
    stop: StopView | None = Field(description="Why it must not be used at all; null if it may be used")
    summary: str
    common: list[CommonView] = Field(description="What held-out data have in common with the data of the fit")
    drift: DriftView | None = Field(default=None, description="null if there was no simulation")
    force: DetectableForceView | None = Field(default=None, description="null if the data do not determine it")
    contact: ContactDetectionView | None = Field(
        default=None, description="null if the model or the data allow no momentum observer"
    )
    mass: float | None = Field(default=None, description="Smallest load at the tool that is visible, kg; null: unknown")
    next_steps: list[str] = Field(description="What to do about the error, the usually cheapest first")
    remedies: list[RemedyView] = Field(default=[], description="Those that reasons of uses quote")
