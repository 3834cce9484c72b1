"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

from dynident_client.answers.shared_answers import DriftView, EffectChoice, ErrorsView, UsedPreprocessing


class CommonView(TypedDict):
    """What held-out data have in common with the data of the fit."""

    detail: str
    fitted_id: str
    held_out_id: str
    kind: Literal["copied", "repeated"]
    """The same samples, or the same motion once more"""
    share: float
    """Of the moving time, 0 to 1"""


class ContactDetectionView(TypedDict):
    """Thresholds of a momentum observer, and the force at the tool that they detect as it happens."""

    false_alarms_an_hour: float
    force: float
    """N, in 95 % of the directions and postures of the held-out motion"""
    gain: float
    """Bandwidth of the observer, 1/s"""
    seconds: float
    """Duration of the held-out motion that it was computed from"""
    speeds: list[list[float | None]]
    """rad/s or m/s between three classes of speed, per joint"""
    thresholds: list[list[float | None]]
    """N m or N, per joint: slow or just slow before, then by class of speed; null: too few data"""
    within: float
    """Seconds within which it shows"""


class CorrelationView(TypedDict):
    """How the estimates of the parameters depend on one another."""

    correlation: list[list[float | None]]
    """Row by row, in the order of `parameters`"""
    parameters: list[str]
    sentences: list[str]
    """Parameters of which the motion determines only combinations, worst first"""


class CurrentModelView(TypedDict):
    """The parameters of one joint's current."""

    held_out_relative: float | None
    """The same as a fraction"""
    held_out_rms: float | None
    """The same on held-out data, A; null if there are none"""
    joint: str
    parameters: list[CurrentParameterView]
    relative: float
    """||i − î|| / ||i|| in the fit"""
    rms: float
    """rms of the residual of the current in the fit, A"""


class CurrentModelsResult(TypedDict):
    """The currents of all joints."""

    joints: list[CurrentModelView]
    """In the robot's order of joints"""


class CurrentParameterView(TypedDict):
    """One parameter of a joint's current: a sum of base parameters divided by the joint's gain."""

    grouping: str
    """As a sum of base parameters"""
    interval: tuple[float | None, float | None]
    """Holds the true value in 95 of 100 cases"""
    judgement: Literal["determined", "uncertain", "zero_in_interval"]
    name: str
    standard_deviation: float | None
    unit: str
    """Unit of the parameter, times A/(N m) or A/N"""
    value: float


class DetectableForceView(TypedDict):
    """The smallest force at the tool that is detected with one false alarm per hour."""

    force: float
    """N, in 95 % of the directions and postures of the held-out motion"""
    seconds: float
    """Duration of the held-out motion that it was computed from"""
    thresholds: list[float | None]
    """Thresholds for every joint's filtered residual, N m or N; null: the joint moves too seldom"""


class EssentialStepView(TypedDict):
    """One step of the elimination: one parameter is removed."""

    name: str
    p_value: float
    """Probability that noise alone is as large as everything that is removed so far"""
    ratio: float | None
    """The largest relative standard deviation divided by the smallest"""
    relative_standard_deviation: float | None
    """Before it was removed, a fraction"""
    residual: ErrorsView
    validation: ErrorsView | None


class EssentialView(TypedDict):
    """The essential parameters of a model: those left by backward elimination."""

    essential: list[str]
    parameters: list[ParameterView]
    """Estimated again with the others at zero"""
    reason: str
    """Why the elimination stopped"""
    residual: ErrorsView
    steps: list[EssentialStepView]
    tables: list[Table]
    """The steps and the parameters as tables for people"""
    validation: ErrorsView | None


class IdentificationResult(TypedDict):
    """An identified model."""

    condition_meaning: str
    """What the equilibrated condition number means"""
    condition_number: float | None
    """Of W [12.12]; parameters of other units change it"""
    confirmed_by: list[Literal["moving", "reversing", "starting"]] | None
    """Held-out rows on which what was added surely lowers the error: where joints move; at reversals and at starts of
    its joints, where the effect claims to explain these; [] if none do; null if not judged"""
    converged: bool
    """Whether the iterations of the estimator have converged"""
    copied: list[str]
    """Held-out measurements, by name, that contain samples of the fit"""
    dependence: list[str]
    """Parameters of which the motion determines only combinations"""
    effective_rows: list[float]
    """Effective number of independent samples of each joint's rows"""
    effects: list[EffectChoice]
    effort_units: list[str]
    equations_per_parameter: float
    equilibrated_condition_number: float | None
    """The same with rows over their noise and columns of unit norm; null in models that an older version stored"""
    inertia_matrix_positive_definite: bool
    joints: list[str]
    measurements: list[SeenMeasurement]
    """Which revision of which file the model used; [] in models that an older version stored"""
    n_equations: int
    parameters: list[ParameterView]
    parent_id: str | None
    preprocessing: UsedPreprocessing
    residual: ErrorsView
    rungs: list[StepView]
    """Models between the parent and this one: an extension makes one for every effect"""
    shape_constants: list[ShapeConstantView]
    """Uncertainty of the effects' shape constants, including the uncertainty of the other parameters"""
    validation: ErrorsView | None
    warnings: list[str]


class LadderStep(TypedDict):
    """One step of the ladder."""

    added: list[EffectChoice]
    best: bool
    """Whether it has the smallest validation error of the ladder where joints move (`validation.moving`). Less than 0.5
    % of it is no difference, unless held-out data confirm what was added."""
    confirmed_by: list[Literal["moving", "reversing", "starting"]] | None
    """Held-out rows on which what was added surely lowers the error: where joints move; at reversals and at starts of
    its joints, where the effect claims to explain these; [] if none do; null if not judged"""
    effects: list[EffectChoice]
    id: str
    n_parameters: int | None
    name: str | None
    parent_id: str | None
    part_of: str | None
    """The identification that made this model as an intermediate step; null if the model is a resource itself"""
    removed: list[EffectChoice]
    residual: ErrorsView | None
    rises: bool
    """After the best step, with a larger validation error where joints move: the added effect makes the model worse"""
    status: str
    validation: ErrorsView | None


class LadderStepDifference(TypedDict):
    """The same step of two ladders: this ladder's error minus the other's; negative if this one is better."""

    against_id: str | None
    """null if the other ladder has ended"""
    id: str | None
    """null if this ladder has ended"""
    n_parameters: int | None
    residual: list[float | None] | None
    """Relative error per joint"""
    residual_moving: list[float | None] | None
    """Where each joint moves"""
    residual_moving_total: float | None
    residual_total: float | None
    rung: int
    """Number of the step, from 1 for the first model"""
    validation: list[float | None] | None
    """Relative held-out error per joint"""
    validation_moving: list[float | None] | None
    """Where each joint moves"""
    validation_moving_total: float | None
    validation_total: float | None


class Lineage(TypedDict):
    """The models that led to one, the first one first; if requested, compared with those that led to another."""

    against: list[LadderStep] | None
    common_ancestor: str | None
    """The last model that both ladders contain"""
    differences: list[LadderStepDifference] | None
    items: list[LadderStep]
    same_data: bool | None
    """Whether all models of both ladders use the same measurements"""


class ParameterView(TypedDict):
    """One base parameter."""

    effect: str
    essential: bool
    """False: set to zero because it is not essential"""
    grouping: str
    """As a sum of standard parameters"""
    interval: tuple[float | None, float | None]
    """Holds the true value in 95 of 100 cases"""
    judgement: Literal["determined", "uncertain", "zero_in_interval"] | None
    """From its 95 % interval: determined (standard deviation at most a tenth of the value, and mainly from the data),
    uncertain, or not distinguishable from zero"""
    link: str
    name: str
    relative_standard_deviation: float | None
    """A fraction"""
    shape_parameters: dict[str, float]
    standard_deviation: float | None
    times_smallest: float | None
    """Relative standard deviation divided by the smallest of all: above ten, poorly identified by §12.7"""
    unit: str
    value: float
    well_identified: bool
    """Whether the data determine it, by its judgement"""


class ReportResult(TypedDict):
    """The report document."""

    href: str
    media_type: str
    size: int
    """Bytes"""


class SeenMeasurement(TypedDict):
    """A measurement as a model used it."""

    edits: list[dict[str, Any]]
    """Changes to the metadata since the upload, in order"""
    id: str
    name: str | None
    parent_id: str | None
    revision: int
    """0: as it was uploaded"""
    role: Literal["identification", "validation"]
    sha256: str
    """Hash of the file as it was uploaded"""


class ShapeConstantView(TypedDict):
    """A constant inside an effect's columns: a Stribeck velocity, a slip distance, the frequency of a ripple."""

    description: str
    effect: str
    interval: tuple[float, float] | None
    """Holds the true value in 95 of 100 cases"""
    joints: list[str]
    """Empty if the effect acts on the whole robot"""
    judgement: Literal["determined", "uncertain", "not_determined", "at_edge", "elsewhere", "chosen", "not_looked_at"]
    """determined; uncertain; not_determined: the interval covers the whole search range; at the edge of that range; the
    data prefer a value outside it; chosen among a few kinds; not examined, without a recording"""
    name: str
    note: str
    """Why there is no interval, or what is unusual about it; otherwise empty"""
    standard_deviation: float | None
    """null if the uncertainty is unknown"""
    unit: str
    value: float


class StepView(TypedDict):
    """A model between the parent and this one; it has one effect more than the model before it."""

    added: list[EffectChoice]
    confirmed_by: list[Literal["moving", "reversing", "starting"]] | None
    """Held-out rows on which what was added surely lowers the error: where joints move; at reversals and at starts of
    its joints, where the effect claims to explain these; [] if none do; null if not judged"""
    n_parameters: int
    residual: ErrorsView
    validation: ErrorsView | None


class StopView(TypedDict):
    """The most probable cause of a large error."""

    apply: dict[str, Any] | None
    """Correction: a body for POST /v1/measurements/{measurement_id}/revisions"""
    cause: str
    measurement_id: str | None
    """Place of the fault, as far as it is known"""


class Table(TypedDict):
    """A table for people: the same on the command line and in reports."""

    columns: list[TableColumn]
    groups: list[str]
    """Heading above each row; [] if there are none"""
    rows: list[list[TableCell]]
    title: str


class TableCell(TypedDict):
    """The content of one cell."""

    mark: Literal["ok", "warning", "error", "plain"] | None
    """Rating of the value"""
    note: str
    """Further explanation"""
    text: str
    value: float | None
    """The exact value, if the cell is a number"""


class TableColumn(TypedDict):
    """A column of a table."""

    figures: bool
    """Whether it contains numbers"""
    word: str


class Tables(TypedDict):
    """Several tables."""

    items: list[Table]


class UseView(TypedDict):
    """Whether the model is fit for a use."""

    fit: bool
    """Whether it may be used so, at least within the limit that the reason names"""
    next_step: str
    """The next thing to do"""
    reason: str
    state: Literal["yes", "limited", "no", "not_judged"]
    """limited: fit within a limit; not_judged: there are no data to judge by"""
    use: Literal["simulation", "feed_forward", "collision_detection", "payload"]


class VerdictView(TypedDict):
    """What a model is fit for, and why or why not."""

    common: list[CommonView]
    """What held-out data have in common with the data of the fit"""
    contact: ContactDetectionView | None
    """null if the model or the data allow no momentum observer"""
    drift: DriftView | None
    """null if there was no simulation"""
    force: DetectableForceView | None
    """null if the data do not determine it"""
    held_out: ErrorsView | None
    """The data that it was judged by; null without held-out data"""
    mass: float | None
    """Smallest load at the tool that is visible, kg; null: unknown"""
    next_steps: list[str]
    """What to do about the error, the usually cheapest first"""
    stop: StopView | None
    """Why it must not be used at all; null if it may be used"""
    summary: str
    uses: list[UseView]
