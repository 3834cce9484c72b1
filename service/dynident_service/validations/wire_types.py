"""Bodies and answers of validations."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field

from dynident.validation.validation_request import TRIALS, Method, Stated
from dynident_service.shared.request_bodies import derive_body, describe_choices
from dynident_service.shared.wire_types import (
    Computed,
    ContactDetectionView,
    DriftView,
    ErrorsView,
    Identifier,
    NamedRequest,
    RequestModel,
    SourcePath,
    UsedPreprocessing,
    ViewModel,
    WithTables,
)

if TYPE_CHECKING:
    ValidationKind = str
else:
    ValidationKind = Literal[TRIALS.names]
VerdictWord = Literal["pass", "fail", "not_evaluated"]


@derive_body(Method)
class MethodRequest(RequestModel):
    """A method of identification."""


@derive_body(Stated)
class ValidationRequest(NamedRequest):
    """The model to validate, and how."""

    identification_id: Identifier
    kind: ValidationKind = Field(
        description=" ".join(f"{choice.name}: {choice.words}" for choice in TRIALS.choices),
        json_schema_extra=describe_choices(TRIALS),
    )
    measurement_ids: list[Identifier] | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description="cross, methods: data that the model has not seen, by default its validation data; collision: such "
        "data without contacts; drift: motions to simulate, by default its validation data or else all measurements of "
        "the identification; simulation, filters: the motion to simulate, by default a measurement of the "
        "identification; payload: the runs with the load",
    )


class MeasurementErrors(ViewModel):
    """Errors of the model on one measurement."""

    measurement_id: str
    name: str
    errors: ErrorsView


class MethodView(ViewModel):
    """Result of one method on the data that all methods share."""

    method: Annotated[str, SourcePath("method.words")] = Field(description="Description in words")
    model: Annotated[str, SourcePath("method.model")]
    strategy: Annotated[str, SourcePath("method.strategy")]
    estimator: str | dict[str, Any] = Field(description="Its name, or an object with its options")
    steps: Annotated[str, SourcePath("method.steps")]
    prior: Annotated[str | None, SourcePath("method.prior")]
    problem: str | None = Field(description="Why there is no result")
    values: list[float | None] | None = Field(description="Parameters in the order of `parameters`")
    standard_deviations: list[float | None] | None
    fit: ErrorsView | None
    held_out: ErrorsView | None = Field(
        description="On validation data; without any, on the data of the identification"
    )
    distance: list[float | None] | None = Field(
        description="Distance of each parameter from the first method's, in units of their joint standard deviation"
    )
    distance_rms: float | None
    farthest: str | None = Field(description="The parameter that is farthest from the first method's")
    torque_distance: float | None = Field(
        description="Distance of the predicted torque from that of the first method, as a share of the measured torque"
    )
    torque_deviation: float | None = Field(
        description="The part of it that the uncertainty of its own parameters explains"
    )
    seconds: float = Field(description="Time of the solution")
    warnings: list[str]


class SimulationOnMeasurement(ViewModel):
    """A simulated robot that follows a recorded motion, and one without a controller."""

    measurement_id: str
    name: str
    duration: float = Field(description="Seconds that are simulated")
    torque: ErrorsView | None = Field(description="Simulated against measured torque")
    position: list[float | None] | None = Field(description="rad or m, root mean square, per joint")
    position_share: list[float | None] | None = Field(
        description="The same, divided by the range that the joint moved through"
    )
    drift: DriftView | None = Field(
        default=None, description="Drift without a controller; null if nothing could be simulated"
    )
    verdict: Annotated[VerdictWord, SourcePath("judged.verdict")]
    reason: Annotated[str, SourcePath("judged.reason")]


class FilterTrialView(ViewModel):
    """Effect of one choice of filters on the parameters of the simulated identification."""

    preprocessing: UsedPreprocessing
    error: float | None = Field(description="Torque error because of wrong parameters, as a share of the torque")
    bias: float | None = Field(description="The part of it that is the same in every draw of the noise")
    worst: str | None = Field(description="The parameter with the largest bias, in its standard deviations")
    worst_bias: float | None
    problem: str | None


class FiltersView(ViewModel):
    """Filters by simulation of the identification."""

    used: FilterTrialView
    chosen: FilterTrialView
    trials: list[FilterTrialView]
    position_noise: Annotated[list[float | None], SourcePath("noise.position")] = Field(
        description="Of the encoders, rad or m, per joint"
    )
    torque_noise: Annotated[list[float | None], SourcePath("noise.torque")] = Field(description="N m or N, per joint")


class DriveGainView(ViewModel):
    """The drive gain [12.17] of one joint, from runs without and with a known load."""

    joint: str
    drive_gain: float = Field(description="N m or N per unit of the recorded torque or current")
    interval: tuple[float | None, float | None] = Field(description="95 %")
    factor: float = Field(description="Factor for the recorded torque")
    identifiable: bool


class PayloadView(ViewModel):
    """A load weighed by runs without and with it."""

    measurement_id: str
    name: str
    stated_mass: Annotated[float, SourcePath("stated")] = Field(description="kg")
    identifiable: Annotated[bool, SourcePath("weighed.identifiable")] = Field(
        description="Whether the motion distinguishes the load from friction"
    )
    mass: Annotated[float | None, SourcePath("weighed.mass")] = Field(description="kg; null if it is not identifiable")
    interval: Annotated[tuple[float, float] | None, SourcePath("weighed.interval")] = Field(
        description="Holds the true mass in 95 of 100 cases, kg"
    )
    friction_shared: Annotated[float | None, SourcePath("weighed.alike.mass")] = Field(
        description="kg, if friction is the same in all runs"
    )
    friction_apart: Annotated[float | None, SourcePath("weighed.apart.mass")] = Field(
        description="kg, if every run has friction of its own"
    )
    gains: Annotated[list[DriveGainView], SourcePath("gains.each")] = Field(
        default=[], description="Gains that would give the stated mass"
    )
    verdict: Annotated[VerdictWord, SourcePath("judged.verdict")]
    reason: Annotated[str, SourcePath("judged.reason")]


class DrawnParameterView(ViewModel):
    """The standard deviation of one parameter: reported, and over draws of blocks of time."""

    name: str = Field(description="A parameter, or ln and the name of a shape constant that is searched for in ratios")
    unit: str
    told: float | None
    drawn: float | None
    ratio: float | None = Field(description="drawn divided by told")
    expected: tuple[float, float] = Field(
        description="Range of the ratio that comes only from the small number of blocks"
    )
    outside: bool


class BootstrapView(ViewModel):
    """Standard deviations over draws of blocks of the reduced data, and the reported ones."""

    kind: Literal["wild", "pairs"] | None = Field(
        description="wild: residuals of each block weighted at random; pairs: blocks drawn with replacement"
    )
    stretches: int
    draws: int
    lost: int = Field(description="Draws that do not determine all parameters")
    parameters: list[DrawnParameterView]


class ValidationResult(ViewModel):
    """Result of one validation, with the verdict and its reason in a sentence."""

    kind: ValidationKind
    verdict: Annotated[VerdictWord, SourcePath("judged.verdict")]
    reason: Annotated[str, SourcePath("judged.reason")]
    limit: float | None = Field(default=None, description="Limit of the relative error")
    measurements: list[MeasurementErrors] = Field(default=[])
    total: ErrorsView | None = Field(default=None, description="Over all measurements")
    inertia_matrix_positive_definite: bool | None = None
    smallest_eigenvalue: float | None = Field(
        default=None, description="Of the inertia matrix scaled to a unit diagonal, in the worst posture found"
    )
    eigenvalue_standard_deviation: float | None = None
    worst_posture: dict[str, float] | None = Field(default=None, description="rad or m, by joint")
    postures_tried: int | None = None
    parameters: list[str] = Field(default=[], description="Names of the parameters that methods are compared by")
    methods: list[MethodView] = Field(default=[])
    simulations: list[SimulationOnMeasurement] = Field(default=[])
    drift: DriftView | None = Field(
        default=None, description="Over all measurements; null if no physical robot can have the parameters"
    )
    contact: ContactDetectionView | None = Field(
        default=None, description="Thresholds and the force that they detect, from all measurements"
    )
    alarms: int | None = Field(
        default=None, description="False alarms in the measurements, each with the thresholds from the others"
    )
    expected_alarms: Annotated[float | None, SourcePath("expected")] = Field(
        default=None, description="How many the stated rates let expect there"
    )
    filters: FiltersView | None = None
    payloads: list[PayloadView] = Field(default=[])
    bootstrap: BootstrapView | None = None


class ValidationView(Computed[ValidationRequest, ValidationResult], WithTables):
    """A validation."""
