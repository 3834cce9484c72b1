"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Literal, TypedDict

from dynident_client.answers.shared_answers import ErrorFigures


class AutocorrelationView(TypedDict):
    """Autocorrelation of a joint's residual."""

    effective_samples: float
    """Effective number of independent samples of the residual"""
    joint: str
    lag: list[float]
    """s"""
    limit: float
    """Half-width of the 95 % band of independent samples"""
    n_samples: int
    value: list[float]
    """1 at lag 0"""


class ComparisonResult(TypedDict):
    """Difference of measured and predicted torque; at standstill, the distance to the range of static friction."""

    effective_samples: list[float | None]
    """Effective number of independent samples of each joint's residual"""
    effort_units: list[str]
    end_time: float
    held_out: bool | None
    """Whether the model was identified without this measurement"""
    joints: list[str]
    lack_of_fit: LackOfFit | None
    """Present if periods are repeated"""
    moving: ErrorFigures | None
    """On the rows where each joint moves"""
    n_samples: int
    noise_floor: list[float | None]
    """rms of the noise after filtering, N m or N"""
    noise_source: Literal["repeated_periods", "high_frequency"] | None
    """Source of the noise floor"""
    notes: list[str]
    """Notes on these figures"""
    over_noise: list[float | None]
    """rms of the residual divided by the noise floor"""
    phases: PhasesView | None
    """Shares of the filtered rows"""
    raw: ErrorFigures | None
    """On all rows; at standstill against the predicted torque itself, where static friction is unknown"""
    relative: list[float | None]
    relative_total: float | None
    repeated_motion: RepeatedMotion | None
    repetition: Repetition | None
    """null if the motion is not repeated"""
    rms: list[float | None]
    start_time: float
    worst: list[WorstInterval]


class LackOfFit(TypedDict):
    """F test of the residual against the noise of repeated periods: near 1 if the model lacks nothing."""

    f: list[float | None]
    """Per joint"""
    p_value: list[float | None]
    """Per joint"""


class PhasesView(TypedDict):
    """Shares of time, 0 to 1, in which each joint stands still (or sticks) or reverses; otherwise it moves."""

    reversing: list[float]
    """Per joint: near reversals, where only rows of friction with memory of the path are used"""
    standing: list[float]
    """Per joint: standstill, where friction may have any value, so its friction rows are not used"""


class RepeatedMotion(TypedDict):
    """A motion of the identification that a held-out run repeats: it tests noise, not generalisation."""

    measurement: str
    """Name of the measurement that the model was identified from"""
    share: float
    """Share of the time in which the robot moves, 0 to 1"""


class Repetition(TypedDict):
    """How often a recording's motion repeats itself."""

    period: float
    """s"""
    repetitions: float
    """Number of periods"""


class ResidualMap(TypedDict):
    """Residual of a joint over one or two signals, in bins; at standstill, distance to the range of static friction."""

    count: list[list[int]]
    effort_unit: str
    joint: str
    mean: list[list[float | None]]
    """[x bin][y bin]; null if a bin is empty"""
    spread: list[list[float | None]]
    """Standard deviation in the bin"""
    x: str
    x_edges: list[float]
    y: str | None
    y_edges: list[float] | None


class Series(TypedDict):
    """Signals of one joint over time, thinned for plots; extremes are kept."""

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
    """Lower end of the predicted torque; at standstill, static friction gives it a range"""
    measured: list[float]
    n_samples: int
    """Number of samples in the interval, of which these are shown"""
    predicted: list[float]
    q: list[float]
    residual: list[float]
    """Measured minus predicted; at standstill, the distance to lower or upper, zero between them"""
    segment: list[int]
    standing: list[bool]
    """Whether the joint stands still"""
    t: list[float]
    upper: list[float]
    """Upper end, like lower; both are `predicted` while the joint moves"""


class SpectralPeak(TypedDict):
    """A peak of a spectrum."""

    amplitude: float
    frequency: float
    per_turn: float | None
    """Cycles per revolution of the joint; null over time and for a linear joint"""


class Spectrum(TypedDict):
    """Amplitude spectrum of a joint's residual: a sine of amplitude A is a peak of height A."""

    amplitude: list[float]
    effort_unit: str
    frequency: list[float]
    frequency_unit: Literal["Hz", "cycles/rad", "cycles/m"]
    joint: str
    over: Literal["angle", "time"]
    peaks: list[SpectralPeak]
    """The highest peaks, highest first"""
    resolution: float
    """Width of a peak, in the unit of the frequency"""


_WorstInterval = TypedDict("_WorstInterval", {"from": float})


class WorstInterval(_WorstInterval):
    """An interval of time in which a joint's residual is large."""

    joint: str
    pose: list[float]
    """Positions of all joints at that moment, rad or m"""
    ratio: float
    """Relative to the joint's own rms"""
    rms: float
    """N m or N"""
    speed: list[float]
    """Velocities of all joints at that moment, rad/s or m/s"""
    time: float | None
    """Time of the largest residual, s"""
    to: float
    """s"""
