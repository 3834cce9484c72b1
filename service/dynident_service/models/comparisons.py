"""Comparisons on the wire."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import ConfigDict, Field

from dynident_service.models.common import Computed, Identifier, NamedRequest, SourcePath, ViewModel
from dynident_service.models.identifications import ErrorFigures
from dynident_service.models.measurements import PhasesView


class ComparisonRequest(NamedRequest):
    """Which model is held against which measurement."""

    identification_id: Identifier
    measurement_id: Identifier


class WorstStretch(ViewModel):
    """A stretch of time where a joint's residual is large."""

    model_config = ConfigDict(serialize_by_alias=True)

    joint: str
    start: float = Field(alias="from", description="s")
    end: float = Field(alias="to", description="s")
    rms: float = Field(description="N m or N")
    ratio: float = Field(description="Over the joint's own rms")
    time: float | None = Field(default=None, description="When it is largest, s")
    pose: list[float] = Field(default=[], description="Positions of all joints at that moment, rad or m")
    speed: list[float] = Field(default=[], description="Velocities of all joints at that moment, rad/s or m/s")


class Repetition(ViewModel):
    """That a recording's motion repeats itself."""

    period: float = Field(description="s")
    repetitions: float = Field(description="How often the motion comes")


class LackOfFit(ViewModel):
    """F test of the residual against the noise of repeated periods: near 1 where nothing is missing in the model."""

    f: list[float | None] = Field(description="Per joint")
    p_value: list[float | None] = Field(description="Per joint")


class RepeatedMotion(ViewModel):
    """An identification motion that a held-out run repeats: it tests noise, not generalisation."""

    measurement: Annotated[str, SourcePath("name")] = Field(
        description="Name of the measurement that the model was identified from"
    )
    share: float = Field(description="Of the time that the robot moves, 0 to 1")


class Judgement(ViewModel):
    """What a residual is worth beside the noise."""

    noise_floor: Annotated[list[float | None], SourcePath("noise.values")] = Field(
        default=[], description="rms of the noise behind the filter, N m or N"
    )
    noise_source: Annotated[Literal["repeated_periods", "high_frequency"] | None, SourcePath("noise.source")] = Field(
        default=None, description="What the noise floor is from"
    )
    over_noise: list[float | None] = Field(default=[], description="rms of the residual over the noise floor")
    effective_samples: list[float | None] = Field(
        default=[], description="Independent samples that each joint's residual is worth"
    )
    repetition: Repetition | None = Field(default=None, description="null where the motion does not come twice")
    lack_of_fit: Annotated[LackOfFit | None, SourcePath("noise.lack_of_fit")] = Field(
        default=None, description="There where periods are repeated"
    )
    repeated_motion: Annotated[RepeatedMotion | None, SourcePath("repeated")] = None
    notes: list[str] = Field(default=[], description="What to know of these figures")


class ComparisonResult(Judgement):
    """How far measured and predicted torque are apart; where a joint stands, the distance to what friction may hold."""

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
        default=None, description="On all rows, at rest against the predicted torque itself, which has no sign there"
    )
    phases: PhasesView | None = Field(default=None, description="Of the rows behind the filters")
    worst: list[WorstStretch]
    held_out: bool | None = Field(default=None, description="Whether the model was identified without it")


class ComparisonView(Computed[ComparisonRequest, ComparisonResult]):
    """A comparison."""


class Series(ViewModel):
    """One joint's signals over time, thinned for plotting so that extremes survive."""

    joint: str
    effort_unit: str
    n_samples: int = Field(description="How many there are in the stretch, of which these are shown")
    t: list[float]
    segment: list[int]
    measured: list[float]
    predicted: list[float]
    lower: list[float] = Field(
        default=[], description="Of the predicted torque; where the joint stands, what static friction may hold"
    )
    upper: list[float] = Field(default=[], description="As lower; both are `predicted` where the joint does not stand")
    standing: list[bool] = Field(default=[], description="Where the joint stands")
    residual: list[float] = Field(
        description="Measured minus predicted; where the joint stands, the distance to lower or upper, zero between"
    )
    band: list[float] = Field(description="Half-width of the 95 % band of the residual")
    q: list[float]
    dq: list[float]
    ddq: list[float] = Field(default=[], description="rad/s² or m/s²")
    load: list[float] = Field(default=[], description="Torque of the rigid body alone, without friction, N m or N")


class ResidualMap(ViewModel):
    """A joint's residual over one or two signals, in bins; where it stands, the distance to what friction may hold."""

    joint: str
    effort_unit: str
    x: str
    y: str | None
    x_edges: list[float]
    y_edges: list[float] | None
    mean: list[list[float | None]] = Field(description="[x bin][y bin]; null where a bin is empty")
    spread: list[list[float | None]] = Field(description="Standard deviation in the bin")
    count: list[list[int]]


class SpectralPeak(ViewModel):
    """A line in a spectrum."""

    frequency: float
    amplitude: float
    per_turn: float | None = Field(description="Cycles in a turn of the joint; null over time and for a linear joint")


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
    peaks: list[SpectralPeak] = Field(description="The highest, highest first")


class AutocorrelationView(ViewModel):
    """Autocorrelation of a joint's residual."""

    joint: str
    lag: list[float] = Field(description="s")
    value: list[float] = Field(description="1 at lag 0")
    limit: float = Field(description="Half-width of the 95 % band of independent samples")
    n_samples: int
    effective_samples: float = Field(description="Independent samples that the residual is worth")
