"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

from dynident_client.answers.parts import EffectChoice, ErrorsView, UsedPreprocessing


class CommonView(TypedDict):
    """What held-out data share with those of the fit."""

    detail: str
    fitted_id: str
    held_out_id: str
    kind: Literal["copied", "repeated"]
    """The same samples, or the same motion once more"""
    share: float
    """Of the moving time, 0 to 1"""


class CorrelationView(TypedDict):
    """How the estimates of the parameters depend on one another."""

    correlation: list[list[float | None]]
    """Row by row, in the order of `parameters`"""
    parameters: list[str]
    sentences: list[str]
    """What the motion determines only together, worst first"""


class CurrentModelView(TypedDict):
    """What the current of one joint is made of."""

    held_out_relative: float | None
    """The same as a fraction"""
    held_out_rms: float | None
    """The same where no parameter saw the data, A; null where there are none"""
    joint: str
    parameters: list[CurrentParameterView]
    relative: float
    """||i − î|| / ||i|| in the fit"""
    rms: float
    """Of the residual of the current in the fit, A"""


class CurrentModelsResult(TypedDict):
    """The currents of all joints."""

    joints: list[CurrentModelView]
    """In the robot's order of joints"""


class CurrentParameterView(TypedDict):
    """One parameter of a joint's current: a sum of base parameters over the joint's gain."""

    grouping: str
    """Written out in base parameters"""
    interval: tuple[float | None, float | None]
    """Holds the true value in 95 of 100 cases"""
    judgement: Literal["determined", "uncertain", "zero_in_interval"]
    name: str
    standard_deviation: float | None
    unit: str
    """That of the parameter, times A/(N m), or A/(N)"""
    value: float


class DetectableForceView(TypedDict):
    """The force at the tool that shows above what the model leaves, at one false alarm an hour."""

    force: float
    """N, in 95 % of the directions and the postures of the held-out motion"""
    seconds: float
    """Of held-out motion that this comes from"""
    thresholds: list[float | None]
    """Of every joint's residual behind the model's filters, N m or N; null: it moves too seldom"""


class DriftView(TypedDict):
    """How far a simulation is off that is left alone under the measured torque, root mean square over many starts."""

    after: list[float]
    """s"""
    distance: list[list[float | None]]
    """rad or m, after each time, per joint"""
    joint_names: list[str]
    share: list[list[float | None]]
    """Of the way that the joint made meanwhile"""
    starts: int


class EssentialStepView(TypedDict):
    """One parameter less."""

    name: str
    p_value: float
    """How often noise alone would be as large as all that is taken out so far"""
    ratio: float | None
    """Of the largest to the smallest relative standard deviation"""
    relative_standard_deviation: float | None
    """Before it went, a fraction"""
    residual: ErrorsView
    validation: ErrorsView | None


class EssentialView(TypedDict):
    """The essential parameters of a model: those left by backward elimination."""

    essential: list[str]
    parameters: list[ParameterView]
    """Estimated anew with the others at zero"""
    reason: str
    """Why the elimination ended"""
    residual: ErrorsView
    steps: list[EssentialStepView]
    tables: list[Table]
    """The steps and the parameters as tables for people"""
    validation: ErrorsView | None


class IdentificationResult(TypedDict):
    """An identified model."""

    condition_number: float | None
    converged: bool
    """Whether the rounds that the estimator takes have settled"""
    copied: list[str]
    """Held-out measurements, by name, with samples that the model was fitted to"""
    dependence: list[str]
    """Parameters that the motion determines only together"""
    effective_rows: list[float]
    """Independent samples that each joint's rows are worth"""
    effects: list[EffectChoice]
    effort_units: list[str]
    equations_per_parameter: float
    inertia_matrix_positive_definite: bool
    joints: list[str]
    measurements: list[SeenMeasurement]
    """Which revision of which file the model saw; [] in models that an older version stored"""
    n_equations: int
    parameters: list[ParameterView]
    parent_id: str | None
    preprocessing: UsedPreprocessing
    residual: ErrorsView
    rungs: list[StepView]
    """Models between the parent and this one: an extension makes one for every effect"""
    shape_constants: list[ShapeConstantView]
    """How sure the effects' shape constants are, the other parameters accounted for"""
    validation: ErrorsView | None
    warnings: list[str]


class Lineage(TypedDict):
    """The models that led to one, the first one first; beside those that led to another, where asked."""

    against: list[Rung] | None
    common_ancestor: str | None
    """The last model that is on both ladders"""
    differences: list[RungDifference] | None
    items: list[Rung]
    same_data: bool | None
    """Whether all models of both ladders rest on the same measurements"""


class ParameterView(TypedDict):
    """One base parameter."""

    effect: str
    essential: bool
    """False: set to zero as not essential"""
    grouping: str
    """Written out in standard parameters"""
    interval: tuple[float | None, float | None]
    """Holds the true value in 95 of 100 cases"""
    judgement: Literal["determined", "uncertain", "zero_in_interval"] | None
    """By its 95 % interval: determined (standard deviation within a tenth of the value, and owed to the data),
    uncertain, or not told from zero"""
    link: str
    name: str
    relative_standard_deviation: float | None
    """A fraction"""
    shape_parameters: dict[str, float]
    standard_deviation: float | None
    times_smallest: float | None
    """Relative standard deviation over the smallest of all: above ten, poorly identified by §12.7"""
    unit: str
    value: float
    well_identified: bool
    """Whether the data determine it: its judgement"""


class ReportResult(TypedDict):
    """The document that was made."""

    href: str
    media_type: str
    size: int
    """Bytes"""


class Rung(TypedDict):
    """One model of the ladder."""

    added: list[EffectChoice]
    best: bool
    """The smallest validation error of the ladder"""
    effects: list[EffectChoice]
    id: str
    n_parameters: int | None
    name: str | None
    parent_id: str | None
    part_of: str | None
    """The identification that made it on its way; null for one that is a resource itself"""
    removed: list[EffectChoice]
    residual: ErrorsView | None
    rises: bool
    """Above the best rung, with a larger validation error: what was added does harm"""
    status: str
    validation: ErrorsView | None


class RungDifference(TypedDict):
    """The same rung of two ladders: this ladder's error minus the other's, negative where this one is better."""

    against_id: str | None
    """null where the other ladder has ended"""
    id: str | None
    """null where this ladder has ended"""
    n_parameters: int | None
    residual: list[float | None] | None
    """Relative error per joint"""
    residual_total: float | None
    rung: int
    """From 1, the first model"""
    validation: list[float | None] | None
    """Relative held-out error per joint"""
    validation_total: float | None


class SeenMeasurement(TypedDict):
    """A measurement as a model saw it."""

    edits: list[dict[str, Any]]
    """What was said of the file since, in order"""
    id: str
    name: str | None
    parent_id: str | None
    revision: int
    """0: as it was uploaded"""
    role: Literal["identification", "validation"]
    sha256: str
    """Of the file as it was uploaded"""


class ShapeConstantView(TypedDict):
    """A constant inside an effect's columns: a Stribeck velocity, a slip distance, the frequency of a ripple."""

    description: str
    effect: str
    interval: tuple[float, float] | None
    """Holds the true value in 95 of 100 cases"""
    joints: list[str]
    """Empty where the effect is of the whole robot"""
    judgement: Literal["determined", "uncertain", "not_determined", "at_edge", "elsewhere", "chosen", "not_looked_at"]
    """determined, uncertain; the interval covers all that is searched (not_determined); at the edge of that; the data
    would have it elsewhere; chosen among a few kinds; not looked at, without a recording"""
    name: str
    note: str
    """Why there is no interval, or what is odd about it; empty where nothing is"""
    standard_deviation: float | None
    """null where no number says how sure it is"""
    unit: str
    value: float


class StepView(TypedDict):
    """A model on the way from the parent to this one, with one effect more than the one before."""

    added: list[EffectChoice]
    n_parameters: int
    residual: ErrorsView
    validation: ErrorsView | None


class StopView(TypedDict):
    """The most probable cause of a gross mistake."""

    apply: dict[str, Any] | None
    """What cures it: a body for POST /v1/measurements/{measurement_id}/revisions"""
    cause: str
    measurement_id: str | None
    """Where the mistake is, as far as that is known"""


class Table(TypedDict):
    """A table in words: the same on the command line and in reports."""

    columns: list[TableColumn]
    groups: list[str]
    """The heading that each row stands under; [] where there are none"""
    rows: list[list[TableCell]]
    title: str


class TableCell(TypedDict):
    """What stands in one place of a table."""

    mark: Literal["ok", "warning", "error", "plain"] | None
    """How good the news is"""
    note: str
    """What more there is to say to who asks"""
    text: str
    value: float | None
    """Of a figure, exactly"""


class TableColumn(TypedDict):
    """A column of a table."""

    figures: bool
    """Whether it holds figures"""
    word: str


class Tables(TypedDict):
    """Several tables."""

    items: list[Table]


class UseView(TypedDict):
    """Whether the model is fit for a use."""

    fit: bool
    """Whether it may be used so, if only within the limit that the reason says"""
    next_step: str
    """One thing to do next"""
    reason: str
    state: Literal["yes", "limited", "no", "not_judged"]
    """limited: fit within a limit; not_judged: nothing was there to tell by"""
    use: Literal["simulation", "feed_forward", "collision_detection", "payload"]


class VerdictView(TypedDict):
    """What a model is fit for, and why or why not."""

    common: list[CommonView]
    """What held-out data share with those of the fit"""
    drift: DriftView | None
    """null where no simulation was made"""
    force: DetectableForceView | None
    """null where the data do not tell"""
    held_out: ErrorsView | None
    """What it was judged by; null without held-out data"""
    mass: float | None
    """kg at the tool from which on a load shows; null: not told"""
    next_steps: list[str]
    """What to do about the error, in the order of what it usually costs"""
    stop: StopView | None
    """Why it is not to be used at all; null if it may be used"""
    summary: str
    uses: list[UseView]
