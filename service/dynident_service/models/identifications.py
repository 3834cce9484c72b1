"""Identifications, and batches of them, on the wire."""

from __future__ import annotations

from datetime import datetime
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from dynident.effects.choices import DEFAULT_EFFECTS
from dynident.export.request import ExportChoices
from dynident.identification.choices import EssentialChoices, IdentificationChoices
from dynident.recordings.metadata import PreprocessingChoices
from dynident_service.models.common import (
    LARGEST_BATCH,
    Computed,
    EffectChoice,
    Identifier,
    Labelled,
    NamedRequest,
    RequestModel,
    SourcePath,
    Table,
    ViewModel,
)
from dynident_service.models.measurements import SeenMeasurement
from dynident_service.models.request_bodies import derive_body, derive_query
from dynident_service.storage.records import State

JUDGEMENTS = Literal["determined", "uncertain", "zero_in_interval"]
SHAPE_JUDGEMENTS = Literal[
    "determined", "uncertain", "not_determined", "at_edge", "elsewhere", "chosen", "not_looked_at"
]

if TYPE_CHECKING:
    EssentialQuery = EssentialChoices
    ExportQuery = ExportChoices
else:
    EssentialQuery = derive_query(EssentialChoices)
    ExportQuery = derive_query(ExportChoices)


@derive_body(PreprocessingChoices)
class Preprocessing(RequestModel):
    """Cut-off frequencies in Hz (null: no filter) and decimation; what is not given is chosen from the data."""


@derive_body(IdentificationChoices, "tolerance")
class IdentificationRequest(NamedRequest):
    """What is to be identified, from which measurements, and how."""

    robot_id: Identifier
    measurement_ids: Annotated[list[Identifier], Field(min_length=1, max_length=100)]
    validation_ids: list[Identifier] = Field(default=[], max_length=100)
    effects: list[EffectChoice] = Field(
        default=[EffectChoice(effect=effect.effect) for effect in DEFAULT_EFFECTS], min_length=1, max_length=200
    )
    preprocessing: Preprocessing | Literal["auto"] = "auto"


class ExtensionRequest(NamedRequest):
    """Effects to be added to an identified model."""

    effects: list[EffectChoice] = Field(min_length=1, max_length=200)


class RemovalRequest(NamedRequest):
    """Effects to be taken out of an identified model."""

    effects: list[EffectChoice] = Field(
        min_length=1, max_length=200, description="Off the joints named, off all where none is"
    )


class StoredIdentification(IdentificationRequest):
    """A request as it is stored: with what was added to the parent, or taken out of it."""

    added: list[EffectChoice] = Field(default=[])
    removed: list[EffectChoice] = Field(default=[])


class ParameterView(ViewModel):
    """One base parameter."""

    name: str
    value: float
    unit: str
    standard_deviation: float | None
    relative_standard_deviation: float | None = Field(description="A fraction")
    well_identified: bool = Field(description="Whether the data determine it: its judgement")
    judgement: JUDGEMENTS | None = Field(
        default=None,
        description="By its 95 % interval: determined (standard deviation within a tenth of the value, and owed to the "
        "data), uncertain, or not told from zero",
    )
    times_smallest: float | None = Field(
        default=None,
        description="Relative standard deviation over the smallest of all: above ten, poorly identified by §12.7",
    )
    effect: str
    link: str
    grouping: str = Field(description="Written out in standard parameters")
    shape_parameters: Annotated[dict[str, float], SourcePath("shape")]
    interval: tuple[float | None, float | None] = Field(
        default=(None, None), description="Holds the true value in 95 of 100 cases"
    )
    essential: bool = Field(default=True, description="False: set to zero as not essential")


class ShapeConstantView(ViewModel):
    """A constant inside an effect's columns: a Stribeck velocity, a slip distance, the frequency of a ripple."""

    effect: str
    joints: list[str] = Field(description="Empty where the effect is of the whole robot")
    name: str
    unit: str
    description: str
    value: float
    standard_deviation: float | None = Field(description="null where no number says how sure it is")
    interval: tuple[float, float] | None = Field(description="Holds the true value in 95 of 100 cases")
    judgement: SHAPE_JUDGEMENTS = Field(
        description="determined, uncertain; the interval covers all that is searched (not_determined); at the edge of "
        "that; the data would have it elsewhere; chosen among a few kinds; not looked at, without a recording"
    )
    note: str = Field(description="Why there is no interval, or what is odd about it; empty where nothing is")


class ErrorFigures(ViewModel):
    """Errors of a model on rows: rms in N m or N, relative as ||y − ŷ|| / ||y||; null where a joint has no such row."""

    rms: list[float | None] = Field(description="Per joint")
    relative: list[float | None] = Field(description="Per joint")
    relative_total: float | None


class ErrorsView(ErrorFigures):
    """Errors of a model on data: on all rows, at rest the distance to what static friction may hold."""

    moving: ErrorFigures | None = Field(
        default=None, description="On the rows where each joint moves; null where that was not looked at"
    )
    sigma: list[float | None] | None = Field(default=None, description="Standard deviation of the residual per joint")


class UsedPreprocessing(ViewModel):
    """The filters that were used, and why."""

    position_cutoff: float | None
    torque_cutoff: float | None
    decimation: int
    filter_order: int
    reasons: list[str]


class StepView(ViewModel):
    """A model on the way from the parent to this one, with one effect more than the one before."""

    added: Annotated[list[EffectChoice], SourcePath("step.added")]
    n_parameters: Annotated[int, SourcePath("model.n_parameters")]
    residual: Annotated[ErrorsView, SourcePath("fit")]
    validation: Annotated[ErrorsView | None, SourcePath("held_out")]


class IdentificationResult(ViewModel):
    """An identified model."""

    parameters: list[ParameterView]
    shape_constants: list[ShapeConstantView] = Field(
        default=[], description="How sure the effects' shape constants are, the other parameters accounted for"
    )
    residual: Annotated[ErrorsView, SourcePath("fit")]
    validation: Annotated[ErrorsView | None, SourcePath("held_out")]
    copied: Annotated[list[str], SourcePath("data.copied")] = Field(
        default=[], description="Held-out measurements, by name, with samples that the model was fitted to"
    )
    converged: bool = Field(default=True, description="Whether the rounds that the estimator takes have settled")
    condition_number: float | None
    n_equations: int
    equations_per_parameter: float
    effective_rows: list[float] = Field(description="Independent samples that each joint's rows are worth")
    inertia_matrix_positive_definite: bool
    effects: Annotated[list[EffectChoice], SourcePath("choices.effects")]
    preprocessing: UsedPreprocessing
    warnings: list[str]
    dependence: list[str] = Field(default=[], description="Parameters that the motion determines only together")
    parent_id: str | None
    rungs: list[StepView] = Field(
        default=[], description="Models between the parent and this one: an extension makes one for every effect"
    )
    joints: Annotated[list[str], SourcePath("model.robot.joint_names")]
    effort_units: list[str]
    measurements: list[SeenMeasurement] = Field(
        default=[], description="Which revision of which file the model saw; [] in models that an older version stored"
    )


class IdentificationView(Computed[IdentificationRequest, IdentificationResult], Labelled):
    """An identification."""

    robot_id: str
    parent_id: str | None
    added: list[EffectChoice] = Field(description="What was added to the parent.")
    removed: list[EffectChoice] = Field(description="What was taken out of the parent.")


class EssentialStepView(ViewModel):
    """One parameter less."""

    name: str
    relative_standard_deviation: Annotated[float | None, SourcePath("relative_deviation")] = Field(
        description="Before it went, a fraction"
    )
    ratio: float | None = Field(description="Of the largest to the smallest relative standard deviation")
    p_value: float = Field(description="How often noise alone would be as large as all that is taken out so far")
    residual: Annotated[ErrorsView, SourcePath("fit")]
    validation: Annotated[ErrorsView | None, SourcePath("held_out")]


class EssentialView(ViewModel):
    """The essential parameters of a model: those left by backward elimination."""

    reason: str = Field(description="Why the elimination ended")
    essential: list[str]
    steps: list[EssentialStepView]
    parameters: list[ParameterView] = Field(description="Estimated anew with the others at zero")
    residual: Annotated[ErrorsView, SourcePath("identification.fit")]
    validation: Annotated[ErrorsView | None, SourcePath("identification.held_out")]
    tables: list[Table] = Field(description="The steps and the parameters as tables for people")


class CorrelationView(ViewModel):
    """How the estimates of the parameters depend on one another."""

    parameters: Annotated[list[str], SourcePath("names")]
    correlation: list[list[float | None]] = Field(description="Row by row, in the order of `parameters`")
    sentences: list[str] = Field(description="What the motion determines only together, worst first")


class Rung(ViewModel):
    """One model of the ladder."""

    id: str
    part_of: str | None = Field(
        default=None, description="The identification that made it on its way; null for one that is a resource itself"
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
    best: bool = Field(default=False, description="The smallest validation error of the ladder")
    rises: bool = Field(
        default=False, description="Above the best rung, with a larger validation error: what was added does harm"
    )


class RungDifference(ViewModel):
    """The same rung of two ladders: this ladder's error minus the other's, negative where this one is better."""

    rung: int = Field(description="From 1, the first model")
    id: str | None = Field(description="null where this ladder has ended")
    against_id: str | None = Field(description="null where the other ladder has ended")
    n_parameters: int | None
    residual: list[float | None] | None = Field(description="Relative error per joint")
    residual_total: float | None
    validation: list[float | None] | None = Field(description="Relative held-out error per joint")
    validation_total: float | None


class Lineage(ViewModel):
    """The models that led to one, the first one first; beside those that led to another, where asked."""

    items: list[Rung]
    against: list[Rung] | None = None
    common_ancestor: str | None = Field(default=None, description="The last model that is on both ladders")
    differences: list[RungDifference] | None = None
    same_data: bool | None = Field(
        default=None, description="Whether all models of both ladders rest on the same measurements"
    )


class BatchRequest(RequestModel):
    """Many identifications, each as `POST /v1/identifications` takes it: all of them are accepted, or none."""

    items: list[IdentificationRequest] = Field(
        min_length=1, max_length=LARGEST_BATCH, description="As many as DYNIDENT_MAX_BATCH, or fewer"
    )


class BatchItem(ViewModel):
    """One identification of a batch."""

    id: str
    job_id: str
    status: State


class BatchView(ViewModel):
    """Identifications that were asked for together."""

    id: str
    created_at: datetime
    states: dict[State, int] = Field(description="How many there are in each state; those with none are left out.")
    items: list[BatchItem] = Field(description="In the order of the request, without those that were deleted since.")
