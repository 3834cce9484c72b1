"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Any, Literal, TypedDict

from dynident_client.answers.shared_answers import DriftView, ErrorsView, UsedPreprocessing


class BootstrapView(TypedDict):
    """Standard deviations over draws of blocks of the reduced data, and the reported ones."""

    draws: int
    kind: Literal["wild", "pairs"] | None
    """wild: residuals of each block weighted at random; pairs: blocks drawn with replacement"""
    lost: int
    """Draws that do not determine all parameters"""
    parameters: list[DrawnParameterView]
    stretches: int


class DrawnParameterView(TypedDict):
    """The standard deviation of one parameter: reported, and over draws of blocks of time."""

    drawn: float | None
    expected: tuple[float, float]
    """Range of the ratio that comes only from the small number of blocks"""
    name: str
    """A parameter, or ln and the name of a shape constant that is searched for in ratios"""
    outside: bool
    ratio: float | None
    """drawn divided by told"""
    told: float | None
    unit: str


class DriveGainView(TypedDict):
    """The drive gain [12.17] of one joint, from runs without and with a known load."""

    drive_gain: float
    """N m or N per unit of the recorded torque or current"""
    factor: float
    """Factor for the recorded torque"""
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


class FilterTrialView(TypedDict):
    """Effect of one choice of filters on the parameters of the simulated identification."""

    bias: float | None
    """The part of it that is the same in every draw of the noise"""
    error: float | None
    """Torque error because of wrong parameters, as a share of the torque"""
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


class IdentifiedGain(TypedDict):
    """The drive gain [12.17] of one joint, and the gain that its torque was computed with."""

    drive_gain: float
    """N m or N per unit of the recorded torque or current"""
    factor: float
    """Factor for the recorded torque"""
    identifiable: bool
    interval: tuple[float | None, float | None]
    """95 %"""
    joint: str
    standard_deviation: float | None
    stated: float
    """Gain of the robot; 1 if it states none"""
    unit: str
    """N m/A or N/A; - if the robot states no gain: a factor on the recorded torque"""


class MeasurementErrors(TypedDict):
    """Errors of the model on one measurement."""

    errors: ErrorsView
    measurement_id: str
    name: str


class MethodView(TypedDict):
    """Result of one method on the data that all methods share."""

    distance: list[float | None] | None
    """Distance of each parameter from the first method's, in units of their joint standard deviation"""
    distance_rms: float | None
    estimator: str | dict[str, Any]
    """Its name, or an object with its options"""
    farthest: str | None
    """The parameter that is farthest from the first method's"""
    fit: ErrorsView | None
    held_out: ErrorsView | None
    """On validation data; without any, on the data of the identification"""
    method: str
    """Description in words"""
    model: str
    prior: str | None
    problem: str | None
    """Why there is no result"""
    seconds: float
    """Time of the solution"""
    standard_deviations: list[float | None] | None
    steps: str
    strategy: str
    torque_deviation: float | None
    """The part of it that the uncertainty of its own parameters explains"""
    torque_distance: float | None
    """Distance of the predicted torque from that of the first method, as a share of the measured torque"""
    values: list[float | None] | None
    """Parameters in the order of `parameters`"""
    warnings: list[str]


class PayloadView(TypedDict):
    """A load weighed by runs without and with it."""

    friction_apart: float | None
    """kg, if every run has friction of its own"""
    friction_shared: float | None
    """kg, if friction is the same in all runs"""
    gains: list[DriveGainView]
    """Gains that would give the stated mass"""
    identifiable: bool
    """Whether the motion distinguishes the load from friction"""
    interval: tuple[float, float] | None
    """Holds the true mass in 95 of 100 cases, kg"""
    mass: float | None
    """kg; null if it is not identifiable"""
    measurement_id: str
    name: str
    reason: str
    stated_mass: float
    """kg"""
    verdict: Literal["pass", "fail", "not_evaluated"]


class SimulationOnMeasurement(TypedDict):
    """A simulated robot that follows a recorded motion, and one without a controller."""

    drift: DriftView | None
    """Drift without a controller; null if nothing could be simulated"""
    duration: float
    """Seconds that are simulated"""
    measurement_id: str
    name: str
    position: list[float | None] | None
    """rad or m, root mean square, per joint"""
    position_share: list[float | None] | None
    """The same, divided by the range that the joint moved through"""
    reason: str
    torque: ErrorsView | None
    """Simulated against measured torque"""
    verdict: Literal["pass", "fail", "not_evaluated"]


class ValidationResult(TypedDict):
    """Result of one validation, with the verdict and its reason in a sentence."""

    bootstrap: BootstrapView | None
    eigenvalue_standard_deviation: float | None
    filters: FiltersView | None
    inertia_matrix_positive_definite: bool | None
    kind: Literal["direct", "cross", "inertia_matrix", "simulation", "methods", "filters", "bootstrap", "payload"]
    limit: float | None
    """Limit of the relative error"""
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


class WeighedLoad(TypedDict):
    """A load weighed with the identified gains."""

    from_gains: float | None
    """The part of it that comes from the uncertainty of the gains, kg"""
    identifiable: bool
    """Whether the interval excludes zero: then the load is visible"""
    interval: tuple[float | None, float | None]
    """95 %, kg"""
    mass: float
    """kg"""
    measurement_id: str
    name: str
    standard_deviation: float | None
    """kg"""
