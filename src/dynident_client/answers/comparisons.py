"""What is answered, by the contract: written by `python -m dynident_service.openapi`, not by hand."""

from __future__ import annotations

from typing import Literal, TypedDict

from dynident_client.answers.parts import ErrorFigures


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


class LackOfFit(TypedDict):
    """F test of the residual against the noise of repeated periods: near 1 where nothing is missing in the model."""

    f: list[float | None]
    """Per joint"""
    p_value: list[float | None]
    """Per joint"""


class PhasesView(TypedDict):
    """Shares, 0 to 1, of what each joint does: it stands (or sticks), turns round, or else moves."""

    reversing: list[float]
    """Per joint: rows of friction that remembers the path alone"""
    standing: list[float]
    """Per joint: no rows of its friction, which may hold any torque there"""


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
