"""Bodies and answers of comparisons."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from dynident_service.measurements.wire_types import PhasesView
from dynident_service.shared.wire_types import (
    Computed,
    ErrorFigures,
    Identifier,
    NamedRequest,
    SourcePath,
    ViewModel,
    WithTables,
)


class ComparisonRequest(NamedRequest):
    """The model and the measurement to compare."""

    identification_id: Identifier
    measurement_id: Identifier


class WorstInterval(ViewModel):
    """An interval of time in which a joint's residual is large."""

    model_config = ConfigDict(serialize_by_alias=True)

    joint: str
    start: float = Field(alias="from", description="s")
    end: float = Field(alias="to", description="s")
    rms: float = Field(description="N m or N")
    ratio: float = Field(description="Relative to the joint's own rms")
    time: float | None = Field(default=None, description="Time of the largest residual, s")
    pose: list[float] = Field(default=[], description="Positions of all joints at that moment, rad or m")
    speed: list[float] = Field(default=[], description="Velocities of all joints at that moment, rad/s or m/s")


class Repetition(ViewModel):
    """How often a recording's motion repeats itself."""

    period: float = Field(description="s")
    repetitions: float = Field(description="Number of periods")


class LackOfFit(ViewModel):
    """F test of the residual against the noise of repeated periods: near 1 if the model lacks nothing."""

    f: list[float | None] = Field(description="Per joint")
    p_value: list[float | None] = Field(description="Per joint")


class RepeatedMotion(ViewModel):
    """A motion of the identification that a held-out run repeats: it tests noise, not generalisation."""

    measurement: Annotated[str, SourcePath("name")] = Field(
        description="Name of the measurement that the model was identified from"
    )
    share: float = Field(description="Share of the time in which the robot moves, 0 to 1")


class Judgement(ViewModel):
    """The residual compared with the noise."""

    noise_floor: Annotated[list[float | None], SourcePath("noise.values")] = Field(
        default=[], description="rms of the noise after filtering, N m or N"
    )
    noise_source: Annotated[Literal["repeated_periods", "high_frequency"] | None, SourcePath("noise.source")] = Field(
        default=None, description="Source of the noise floor"
    )
    over_noise: list[float | None] = Field(default=[], description="rms of the residual divided by the noise floor")
    effective_samples: list[float | None] = Field(
        default=[], description="Effective number of independent samples of each joint's residual"
    )
    repetition: Repetition | None = Field(default=None, description="null if the motion is not repeated")
    lack_of_fit: Annotated[LackOfFit | None, SourcePath("noise.lack_of_fit")] = Field(
        default=None, description="Present if periods are repeated"
    )
    repeated_motion: Annotated[RepeatedMotion | None, SourcePath("repeated")] = None
    notes: list[str] = Field(default=[], description="Notes on these figures")


class ComparisonResult(Judgement):
    """Difference of measured and predicted torque; at standstill, the distance to the range of static friction."""

    joints: Annotated[list[str], SourcePath("joint_names")]
    effort_units: Annotated[list[str], SourcePath("units")]
    n_samples: int
    start_time: float
    end_time: float
    rms: list[float | None]
    relative: list[float | None]
    relative_total: float | None
    moving: Annotated[ErrorFigures | None, SourcePath("moving_errors")] = Field(
        default=None, description="On the rows where each joint moves"
    )
    raw: Annotated[ErrorFigures | None, SourcePath("raw_errors")] = Field(
        default=None,
        description="On all rows; at standstill against the predicted torque itself, where static friction is unknown",
    )
    phases: PhasesView | None = Field(default=None, description="Shares of the filtered rows")
    worst: list[WorstInterval]
    held_out: bool | None = Field(default=None, description="Whether the model was identified without this measurement")


class ComparisonView(Computed[ComparisonRequest, ComparisonResult], WithTables):
    """A comparison."""


class Series(ViewModel):
    """Signals of one joint over time, thinned for plots; extremes are kept."""

    joint: str
    effort_unit: str
    n_samples: int = Field(description="Number of samples in the interval, of which these are shown")
    t: list[float]
    segment: list[int]
    measured: list[float]
    predicted: list[float]
    lower: list[float] = Field(
        default=[], description="Lower end of the predicted torque; at standstill, static friction gives it a range"
    )
    upper: list[float] = Field(
        default=[], description="Upper end, like lower; both are `predicted` while the joint moves"
    )
    standing: list[bool] = Field(default=[], description="Whether the joint stands still")
    residual: list[float] = Field(
        description="Measured minus predicted; at standstill, the distance to lower or upper, zero between them"
    )
    band: list[float] = Field(description="Half-width of the 95 % band of the residual")
    q: list[float]
    dq: list[float]
    ddq: list[float] = Field(default=[], description="rad/s² or m/s²")
    load: list[float] = Field(default=[], description="Torque of the rigid body alone, without friction, N m or N")


class ResidualMap(ViewModel):
    """Residual of a joint over one or two signals, in bins; at standstill, distance to the range of static friction."""

    joint: str
    effort_unit: str
    x: str
    y: str | None
    x_edges: list[float]
    y_edges: list[float] | None
    mean: list[list[float | None]] = Field(description="[x bin][y bin]; null if a bin is empty")
    spread: list[list[float | None]] = Field(description="Standard deviation in the bin")
    count: list[list[int]]


class SpectralPeak(ViewModel):
    """A peak of a spectrum."""

    frequency: float
    amplitude: float
    per_turn: float | None = Field(
        description="Cycles per revolution of the joint; null over time and for a linear joint"
    )


class Spectrum(ViewModel):
    """Amplitude spectrum of a joint's residual: a sine of amplitude A is a peak of height A."""

    joint: str
    effort_unit: str
    over: Literal["angle", "time"]
    frequency_unit: Literal["Hz", "cycles/rad", "cycles/m"]
    frequency: Annotated[list[float], SourcePath("spectrum.frequency")]
    amplitude: Annotated[list[float], SourcePath("spectrum.amplitude")]
    resolution: Annotated[float, SourcePath("spectrum.resolution")] = Field(
        description="Width of a peak, in the unit of the frequency"
    )
    peaks: list[SpectralPeak] = Field(description="The highest peaks, highest first")


class AutocorrelationView(ViewModel):
    """Autocorrelation of a joint's residual."""

    joint: str
    lag: list[float] = Field(description="s")
    value: list[float] = Field(description="1 at lag 0")
    limit: float = Field(description="Half-width of the 95 % band of independent samples")
    n_samples: int
    effective_samples: float = Field(description="Effective number of independent samples of the residual")
