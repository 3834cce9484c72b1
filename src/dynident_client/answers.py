"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict


class AutocorrelationView(TypedDict):
    """Autocorrelation of a joint's residual."""

    effective_samples: float
    """Independent samples that the residual is worth"""
    joint: str
    lag: list[float]
    """s"""
    limit: float
    """Half-width of the 95 % band of independent samples"""
    n_samples: int
    value: list[float]
    """1 at lag 0"""


class BaselineValues(TypedDict):
    """The best of the random trajectories."""

    condition_number: float | None
    """[12.12]; null where W has no full rank"""
    count: int
    criterion: float | None
    largest_singular_value: float | None
    log_determinant: float | None
    median_condition_number: float | None
    smallest_singular_value: float | None
    trace_of_inverse: float | None


class BootstrapView(TypedDict):
    """Standard deviations over draws of the reduced data's stretches of time, beside those that are told."""

    draws: int
    kind: Literal["wild", "pairs"] | None
    """wild: residuals of each stretch weighted at random; pairs: stretches drawn with replacement"""
    lost: int
    """Draws that do not determine all parameters"""
    parameters: list[DrawnParameterView]
    stretches: int


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


class CapsuleView(TypedDict):
    """All points within a radius of a segment, fixed to a frame: encloses a part of the link's collision geometry."""

    end: tuple[float, float, float]
    """m"""
    frame: int | None
    """Place of the frame that it moves with; null on the base"""
    radius: float
    """m"""
    start: tuple[float, float, float]
    """m"""


class Catalogue(TypedDict):
    """All effects."""

    items: list[EffectView]


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


class CheckView(TypedDict):
    """One thing that was looked at, what was found, and what to do about it."""

    apply: dict[str, Any] | None
    """What cures it, where that is known: a body for POST /v1/measurements/{id}/revisions; of a file that was refused,
    fields for the metadata of another try"""
    column: str
    """Of the file"""
    detail: str
    name: str
    row: int | None
    """Data row of the file, from 1"""
    status: Literal["ok", "warning", "error"]
    time: float | None
    """Seconds of t"""


class CommonView(TypedDict):
    """What held-out data share with those of the fit."""

    detail: str
    fitted_id: str
    held_out_id: str
    kind: Literal["copied", "repeated"]
    """The same samples, or the same motion once more"""
    share: float
    """Of the moving time, 0 to 1"""


class ComparisonResult(TypedDict):
    """How far measured and predicted torque are apart; where a joint stands, the distance to what friction may hold."""

    effective_samples: list[float | None]
    """Independent samples that each joint's residual is worth"""
    effort_units: list[str]
    end_time: float
    held_out: bool | None
    """Whether the model was identified without it"""
    joints: list[str]
    lack_of_fit: LackOfFit | None
    """There where periods are repeated"""
    moving: ErrorFigures | None
    """On the rows where each joint moves"""
    n_samples: int
    noise_floor: list[float | None]
    """rms of the noise behind the filter, N m or N"""
    noise_source: Literal["repeated_periods", "high_frequency"] | None
    """What the noise floor is from"""
    notes: list[str]
    """What to know of these figures"""
    over_noise: list[float | None]
    """rms of the residual over the noise floor"""
    phases: PhasesView | None
    """Of the rows behind the filters"""
    raw: ErrorFigures | None
    """On all rows, at rest against the predicted torque itself, which has no sign there"""
    relative: list[float | None]
    relative_total: float | None
    repeated_motion: RepeatedMotion | None
    repetition: Repetition | None
    """null where the motion does not come twice"""
    rms: list[float | None]
    start_time: float
    worst: list[WorstStretch]


class CorrelationView(TypedDict):
    """How the estimates of the parameters depend on one another."""

    correlation: list[list[float | None]]
    """Row by row, in the order of `parameters`"""
    parameters: list[str]
    sentences: list[str]
    """What the motion determines only together, worst first"""


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


class CriterionValues(TypedDict):
    """What a motion is worth; singular values are those of W / √N."""

    condition_number: float | None
    """[12.12]; null where W has no full rank"""
    criterion: float | None
    largest_singular_value: float | None
    log_determinant: float | None
    smallest_singular_value: float | None
    trace_of_inverse: float | None


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


class Dependent(TypedDict):
    """A resource that rests on another one."""

    id: str
    kind: str


class DesignClearances(TypedDict):
    """How near each link is to others and to the surroundings along a motion."""

    links: list[LinkClearances]
    """Those that are kept clear of anything"""
    t: list[float]
    """s"""


class DesignResult(TypedDict):
    """A verified experiment."""

    baseline_values: BaselineValues | None
    criterion_values: CriterionValues
    duration: float
    """s, from home to home"""
    exciting: tuple[float, float]
    """Seconds between which the exciting part lies"""
    expected_parameters: list[ExpectedParameter]
    """How well they will come out"""
    joints: list[str]
    margins: list[Margin]
    n_samples: int
    notes: list[str]
    parameter_names: list[str]
    period: float | None
    runs: list[Run]
    """Of a set of test motions; numbered in the trajectory's segment"""
    sampling_rate: float


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


class DrawnParameterView(TypedDict):
    """The standard deviation of one parameter, as told and over draws of stretches of time."""

    drawn: float | None
    expected: tuple[float, float]
    """Where the ratio is by the randomness of so few stretches alone"""
    name: str
    """A parameter, or ln and name of a shape constant that is searched for in ratios"""
    outside: bool
    ratio: float | None
    """drawn over told"""
    told: float | None
    unit: str


class DriveGainView(TypedDict):
    """The drive gain [12.17] of one joint, from runs without and with a known load."""

    drive_gain: float
    """N m or N per unit of the recorded torque or current"""
    factor: float
    """What the recorded torque is to be multiplied by"""
    identifiable: bool
    interval: tuple[float | None, float | None]
    """95 %"""
    joint: str


class DriveGainsResult(TypedDict):
    """Drive gains of all joints."""

    gains: list[IdentifiedGain]
    """In the robot's order of joints"""
    loads: list[WeighedLoad]
    """In the order of weigh"""
    warnings: list[str]


class EffectChoice(TypedDict):
    """An effect of the catalogue, on some joints."""

    effect: str
    """An id of GET /v1/effects"""
    joints: list[str]
    """Names; all that the effect may sit on where none is given."""
    runs: list[str]
    """Names of the measurements, or labels of their runs, that it is in"""
    shape_parameters: dict[str, float]
    """Shape constants; searched where not given."""


class EffectParameter(TypedDict):
    """One parameter of an effect."""

    description: str
    name: str
    prismatic_unit: str
    unit: str
    """On a revolute joint"""


class EffectView(TypedDict):
    """A physical cause of joint torque."""

    confused_with: list[str]
    formula: str
    """LaTeX"""
    id: str
    parameters: list[EffectParameter]
    scope: Literal["joint", "robot"]
    shape_parameters: list[ShapeParameter]
    signature: str
    """What it leaves in the residual"""
    sources: list[str]
    title: str


class ErrorFigures(TypedDict):
    """Errors of a model on rows: rms in N m or N, relative as ||y − ŷ|| / ||y||; null where a joint has no such row."""

    relative: list[float | None]
    """Per joint"""
    relative_total: float | None
    rms: list[float | None]
    """Per joint"""


class ErrorsView(TypedDict):
    """Errors of a model on data: on all rows, at rest the distance to what static friction may hold."""

    moving: ErrorFigures | None
    """On the rows where each joint moves; null where that was not looked at"""
    relative: list[float | None]
    """Per joint"""
    relative_total: float | None
    rms: list[float | None]
    """Per joint"""
    sigma: list[float | None] | None
    """Standard deviation of the residual per joint"""


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
    validation: ErrorsView | None


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


class ExpectedParameter(TypedDict):
    """How well one parameter will come out."""

    effect: str
    link: str
    name: str
    share: float
    """What is left of its column beside all others; 0: not determined"""
    standard_deviation: float | None
    """null where no noise is stated or it is not determined"""
    unit: str


class FailureSpot(TypedDict):
    """Where a joint's residual is large over one variable."""

    high: float
    joint: str
    low: float
    ratio: float | None
    rms: float
    unit: str
    variable: str


class FilterTrialView(TypedDict):
    """What one choice of filters leaves in the parameters of the simulated identification."""

    bias: float | None
    """The part of it that is the same in every draw of the noise"""
    error: float | None
    """Share of the torque that wrong parameters cost"""
    preprocessing: UsedPreprocessing
    problem: str | None
    worst: str | None
    """The parameter with the largest bias, in its standard deviations"""
    worst_bias: float | None


class FiltersView(TypedDict):
    """Filters by simulation of the identification."""

    chosen: FilterTrialView
    position_noise: list[float | None]
    """Of the encoders, rad or m, per joint"""
    torque_noise: list[float | None]
    """N m or N, per joint"""
    trials: list[FilterTrialView]
    used: FilterTrialView


class FrameView(TypedDict):
    """The frame of a joint that carries a link; it moves with its joint."""

    axis: tuple[float, float, float]
    """Unit vector in this frame that the joint turns about or slides along"""
    name: str
    offset: float
    """rad or m"""
    parent: int | None
    """Place of the frame before it in the list; null on the base"""
    placement: list[list[float]]
    """4 x 4: from this frame at zero position to the one before it"""
    ratios: list[float]
    """Its position is the sum of ratio x position of the robot's joints, plus offset; behind those of the joints stand
    the ratios of the passive positions that closed loops determine, if there are any"""
    type: Literal["revolute", "prismatic"]


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


class GeometryView(TypedDict):
    """What a picture of the robot needs; lengths in m, angles in rad."""

    capsules: list[CapsuleView]
    closed: list[float]
    """Positions of the robot's joints, then the passive ones, at which all loops are closed"""
    frames: list[FrameView]
    """Each behind the one that it stands on"""
    joints: list[str]
    """The robot's joints, in the order of ratios"""
    loops: list[LoopView]
    """What determines the passive positions"""
    notes: list[str]
    """What of the geometry could not be read"""
    surfaces: list[SurfaceView]
    """Drawn instead of their frame's capsules"""


class Health(TypedDict):
    """The service answers."""

    status: Literal["ok"]
    version: str


class IdentificationResult(TypedDict):
    """An identified model."""

    condition_number: float | None
    converged: bool
    """Whether the rounds that the estimator takes have settled"""
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


class IdentifiedGain(TypedDict):
    """The drive gain [12.17] of one joint, beside the one that its torque was computed with."""

    drive_gain: float
    """N m or N per unit of the recorded torque or current"""
    factor: float
    """What the recorded torque is to be multiplied by"""
    identifiable: bool
    interval: tuple[float | None, float | None]
    """95 %"""
    joint: str
    standard_deviation: float | None
    stated: float
    """The robot's own; 1 where it states none"""
    unit: str
    """N m/A or N/A; - where the robot states no gain: a factor on the recorded torque"""


class JointView(TypedDict):
    """One moving joint."""

    antecedent: str | None
    """The joint before it; null on the base."""
    coupling: dict[str, float]
    """Other joints that its motor acts on."""
    drive_gain: float | None
    limits: Limits
    link: str
    name: str
    type: Literal["revolute", "prismatic"]


class KeyUsage(TypedDict):
    """What one key has."""

    bytes: Quota
    """Of its recordings, imports and meshes; each file once, however often it is used"""
    jobs: Quota
    """Queued or running"""
    key: str | None
    """Its name; `null` has what no key sent, and what was there before keys counted"""
    recordings: Quota
    """Measurements, with those that simulations under way will give"""


class LackOfFit(TypedDict):
    """F test of the residual against the noise of repeated periods: near 1 where nothing is missing in the model."""

    f: list[float | None]
    """Per joint"""
    p_value: list[float | None]
    """Per joint"""


class Limits(TypedDict):
    """Limits of one joint: rad or m, rad/s or m/s, …, N m or N, and W."""

    acceleration: float | None
    """rad/s² or m/s²"""
    effort: float | None
    """N m or N"""
    jerk: float | None
    """rad/s³ or m/s³"""
    position: tuple[float, float] | None
    """Lowest and highest, rad or m"""
    power: float | None
    """Of torque times velocity, in W"""
    velocity: float | None
    """rad/s or m/s"""


class Lineage(TypedDict):
    """The models that led to one, the first one first; beside those that led to another, where asked."""

    against: list[Rung] | None
    common_ancestor: str | None
    """The last model that is on both ladders"""
    differences: list[RungDifference] | None
    items: list[Rung]
    same_data: bool | None
    """Whether all models of both ladders rest on the same measurements"""


class LinkClearances(TypedDict):
    """What a link is nearest to, sample by sample: what leaves least over the distance that is wanted."""

    distance: list[float]
    """m; negative where they overlap"""
    frame: int
    """Place in the frames of the robot's geometry"""
    here: list[tuple[float, float, float]]
    """Nearest point of the link in its frame, m"""
    name: str
    others: list[Other]
    there: list[tuple[float, float, float]]
    """Nearest point of the other in its own frame, m"""
    to: list[int]
    """Place in the others"""
    wanted: list[float]
    """m"""


class LoopEndView(TypedDict):
    """One side of a cut joint: a frame fixed to a link."""

    frame: int | None
    """Place of the frame that it moves with; null on the base"""
    placement: list[list[float]]
    """4 x 4: from this side to that frame"""


class LoopView(TypedDict):
    """A closed loop: the two sides coincide, wholly, in their origins, or in the xy plane of the first."""

    ends: tuple[LoopEndView, LoopEndView]
    kind: Literal["planar", "point", "full"]
    name: str


class Margin(TypedDict):
    """How near the motion comes to a limit, on a fine grid."""

    bound: float
    joint: str
    """The joint; of a clearance, the two that come near each other; of a condition: loops"""
    limit: str
    """position_min, position_max, velocity, …, torque, power, clearance, tool_min, tool_max or condition"""
    share: float | None
    """Of the room that is used: 1 touches the limit"""
    value: float
    """The extreme one"""


class MeasurementErrors(TypedDict):
    """Errors of the model on one measurement."""

    errors: ErrorsView
    measurement_id: str
    name: str


class MeshView(TypedDict):
    """A mesh that the description names for collisions."""

    links: list[str]
    """The links that it is of"""
    name: str
    """As in the description: package://…, or a path"""
    sha256: str | None
    """Of the file that was sent for it; null where none was."""
    size: int | None
    """Bytes"""


class MeshesView(TypedDict):
    """What came of the meshes that were sent."""

    meshes: list[MeshView]
    """All that the description names, in its order"""
    unused: list[str]
    """Files that were sent and that no mesh of the description means"""


class MethodView(TypedDict):
    """What one method gave on the data that all of them share."""

    distance: list[float | None] | None
    """Of every parameter from the first method's, in units of their joint standard deviation"""
    distance_rms: float | None
    estimator: str | dict[str, Any]
    """Its name, or an object with its options"""
    farthest: str | None
    """The parameter that is farthest from the first method's"""
    fit: ErrorsView | None
    held_out: ErrorsView | None
    """On validation data; on the identification's own without any"""
    method: str
    """In words"""
    model: str
    prior: str | None
    problem: str | None
    """Why there is no result"""
    seconds: float
    """That the solution took"""
    standard_deviations: list[float | None] | None
    steps: str
    strategy: str
    torque_deviation: float | None
    """What the uncertainty of its own parameters makes of that"""
    torque_distance: float | None
    """How far the predicted torque is from the first method's, as a share of the measured"""
    values: list[float | None] | None
    """Parameters in the order of `parameters`"""
    warnings: list[str]


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


class Other(TypedDict):
    """What a link may be near to: another link, or a part of the surroundings."""

    frame: int | None
    """Place in the frames of the robot's geometry; null on the base"""
    name: str


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


class PayloadView(TypedDict):
    """A load weighed by runs without and with it."""

    friction_apart: float | None
    """kg, if every run has friction of its own"""
    friction_shared: float | None
    """kg, if friction is the same in all runs"""
    gains: list[DriveGainView]
    """What they would have to be for the stated mass"""
    identifiable: bool
    """Whether the motion tells the load from friction"""
    interval: tuple[float, float] | None
    """Holds the true mass in 95 of 100 cases, kg"""
    mass: float | None
    """kg; null where it is not identifiable"""
    measurement_id: str
    name: str
    reason: str
    stated_mass: float
    """kg"""
    verdict: Literal["pass", "fail", "not_evaluated"]


class PhasesView(TypedDict):
    """Shares, 0 to 1, of what each joint does: it stands (or sticks), turns round, or else moves."""

    reversing: list[float]
    """Per joint: rows of friction that remembers the path alone"""
    standing: list[float]
    """Per joint: no rows of its friction, which may hold any torque there"""


class Problem(TypedDict, total=False):
    """The body of every error (RFC 9457)."""

    checks: list[dict[str, Any]] | None
    """All that was found in a file."""
    dependents: list[Dependent] | None
    """On 409: what has to be deleted first."""
    dependents_count: int | None
    """On 409: how many there are; not all are listed."""
    detail: str
    errors: list[ProblemField] | None
    request_id: str | None
    """Under which the service's log tells of the request."""
    status: int
    title: str
    type: str


class ProblemField(TypedDict, total=False):
    """One field, column or parameter that is wrong."""

    detail: str
    pointer: str
    """A JSON pointer into the body, a column of a file, or the name of a parameter."""
    row: int | None
    """Data row of a file, from 1"""
    time: float | None
    """Seconds of t"""


class QuestionView(TypedDict):
    """What has to be answered before the file can be used."""

    choices: list[str] | None
    detail: str
    field: str


class Quota(TypedDict):
    """How much there is of one thing, and how much there may be."""

    allowed: int | None
    """`null` where there is no limit"""
    used: int


class RawSignals(TypedDict):
    """Signals of a measurement's file; nothing is filtered, mended or resampled."""

    n_samples: int
    """How many there are from `from` to `to`, of which these are shown"""
    signals: dict[str, list[float | None]]
    """As long as t; null where there is no number"""
    t: list[float | None]
    """s"""
    units: dict[str, str]
    """By signal; empty for a column of the file that is given as it stands"""


class Readiness(TypedDict):
    """Whether the service can do its work, part by part."""

    checks: dict[str, str]
    status: Literal["ready", "not_ready"]


class RepeatedMotion(TypedDict):
    """An identification motion that a held-out run repeats: it tests noise, not generalisation."""

    measurement: str
    """Name of the measurement that the model was identified from"""
    share: float
    """Of the time that the robot moves, 0 to 1"""


class Repetition(TypedDict):
    """That a recording's motion repeats itself."""

    period: float
    """s"""
    repetitions: float
    """How often the motion comes"""


class ReportResult(TypedDict):
    """The document that was made."""

    href: str
    media_type: str
    size: int
    """Bytes"""


class ResidualMap(TypedDict):
    """A joint's residual over one or two signals, in bins; where it stands, the distance to what friction may hold."""

    count: list[list[int]]
    effort_unit: str
    joint: str
    mean: list[list[float | None]]
    """[x bin][y bin]; null where a bin is empty"""
    spread: list[list[float | None]]
    """Standard deviation in the bin"""
    x: str
    x_edges: list[float]
    y: str | None
    y_edges: list[float] | None


class Run(TypedDict):
    """One test motion of a set."""

    end: float
    """s"""
    joints: list[str]
    """Those that move; the others are locked"""
    label: str
    start: float
    """s"""


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


class Series(TypedDict):
    """One joint's signals over time, thinned for plotting so that extremes survive."""

    band: list[float]
    """Half-width of the 95 % band of the residual"""
    ddq: list[float]
    """rad/s² or m/s²"""
    dq: list[float]
    effort_unit: str
    joint: str
    load: list[float]
    """Torque of the rigid body alone, without friction, N m or N"""
    lower: list[float]
    """Of the predicted torque; where the joint stands, what static friction may hold"""
    measured: list[float]
    n_samples: int
    """How many there are in the stretch, of which these are shown"""
    predicted: list[float]
    q: list[float]
    residual: list[float]
    """Measured minus predicted; where the joint stands, the distance to lower or upper, zero between"""
    segment: list[int]
    standing: list[bool]
    """Where the joint stands"""
    t: list[float]
    upper: list[float]
    """As lower; both are `predicted` where the joint does not stand"""


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


class ShapeParameter(TypedDict):
    """A constant inside an effect's columns, searched for rather than solved for."""

    default: float
    description: str
    name: str
    unit: str
    words: list[ShapeWord]
    """Empty where the constant is a number"""


class ShapeWord(TypedDict):
    """What a value of a constant means that is a choice between kinds."""

    value: float
    word: str


class SimulationOnMeasurement(TypedDict):
    """A simulated robot that followed a recorded motion."""

    duration: float
    """Seconds that were simulated"""
    measurement_id: str
    name: str
    position: list[float | None] | None
    """rad or m, root mean square, per joint"""
    position_share: list[float | None] | None
    """The same over the range the joint moved through"""
    reason: str
    torque: ErrorsView | None
    """Simulated against measured torque"""
    verdict: Literal["pass", "fail", "not_evaluated"]


class SimulationResult(TypedDict):
    """What the virtual robot's measurement is."""

    measurement_id: str
    n_samples: int
    noise: list[float]
    """Standard deviation of the torque noise per joint: no model does better."""
    sampling_rate: float
    tracking_error: list[float]
    """Largest distance from the reference per joint"""


class SpectralPeak(TypedDict):
    """A line in a spectrum."""

    amplitude: float
    frequency: float
    per_turn: float | None
    """Cycles in a turn of the joint; null over time and for a linear joint"""


class Spectrum(TypedDict):
    """Amplitude spectrum of a joint's residual: a sine of amplitude A is a peak of height A."""

    amplitude: list[float]
    effort_unit: str
    frequency: list[float]
    frequency_unit: Literal["Hz", "cycles/rad", "cycles/m"]
    joint: str
    over: Literal["angle", "time"]
    peaks: list[SpectralPeak]
    """The highest, highest first"""
    resolution: float
    """Width of a peak, in the unit of the frequency"""


class Standstills(TypedDict):
    """When every joint of a measurement stands: there friction may hold any torque."""

    joints: list[StandstillsOfJoint]


class StandstillsOfJoint(TypedDict):
    """When one joint stands."""

    joint: str
    standing: list[tuple[float, float]]
    """Seconds of t, [from, to], one after another"""


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


class SurfaceView(TypedDict):
    """The surface of a link's meshes as triangles, fixed to a frame; thinned, for pictures."""

    frame: int | None
    """Place of the frame that it moves with; null on the base"""
    points: list[tuple[float, float, float]]
    """m"""
    triangles: list[tuple[int, int, int]]
    """Places in the list of points"""


class UnknownPattern(TypedDict):
    """A dependence of the residual that no effect of the catalogue explains."""

    joint: str
    share: float | None
    variable: Literal["position", "velocity", "acceleration", "load", "time", "other_joints"]


class UsageView(TypedDict):
    """What is used, key by key."""

    items: list[KeyUsage]


class UseView(TypedDict):
    """Whether the model is fit for a use."""

    fit: bool
    reason: str
    use: Literal["simulation", "feed_forward", "collision_detection", "payload"]


class UsedPreprocessing(TypedDict):
    """The filters that were used, and why."""

    decimation: int
    filter_order: int
    position_cutoff: float | None
    reasons: list[str]
    torque_cutoff: float | None


class ValidationResult(TypedDict):
    """What the model is worth by one test, with the verdict and its reason in a sentence."""

    bootstrap: BootstrapView | None
    eigenvalue_standard_deviation: float | None
    filters: FiltersView | None
    inertia_matrix_positive_definite: bool | None
    kind: Literal["direct", "cross", "inertia_matrix", "simulation", "methods", "filters", "bootstrap", "payload"]
    limit: float | None
    """The relative error that was the limit"""
    measurements: list[MeasurementErrors]
    methods: list[MethodView]
    parameters: list[str]
    """Names of the parameters that methods are compared by"""
    payloads: list[PayloadView]
    postures_tried: int | None
    reason: str
    simulations: list[SimulationOnMeasurement]
    smallest_eigenvalue: float | None
    """Of the inertia matrix scaled to a unit diagonal, in the worst posture found"""
    total: ErrorsView | None
    """Over all measurements"""
    verdict: Literal["pass", "fail", "not_evaluated"]
    worst_posture: dict[str, float] | None
    """rad or m, by joint"""


class VerdictView(TypedDict):
    """What a model is fit for, and why or why not."""

    common: list[CommonView]
    """What held-out data share with those of the fit"""
    held_out: ErrorsView | None
    """What it was judged by; null without held-out data"""
    next_steps: list[str]
    """What to do about the error, in the order of what it usually costs"""
    stop: StopView | None
    """Why it is not to be used at all; null if it may be used"""
    summary: str
    uses: list[UseView]


class WeighedLoad(TypedDict):
    """A load weighed with the identified gains."""

    from_gains: float | None
    """The part of it that the uncertainty of the gains makes, kg"""
    identifiable: bool
    """Whether the interval leaves out zero: whether a load shows at all"""
    interval: tuple[float | None, float | None]
    """95 %, kg"""
    mass: float
    """kg"""
    measurement_id: str
    name: str
    standard_deviation: float | None
    """kg"""


_WorstStretch = TypedDict("_WorstStretch", {"from": float})


class WorstStretch(_WorstStretch):
    """A stretch of time where a joint's residual is large."""

    joint: str
    pose: list[float]
    """Positions of all joints at that moment, rad or m"""
    ratio: float
    """Over the joint's own rms"""
    rms: float
    """N m or N"""
    speed: list[float]
    """Velocities of all joints at that moment, rad/s or m/s"""
    time: float | None
    """When it is largest, s"""
    to: float
    """s"""
