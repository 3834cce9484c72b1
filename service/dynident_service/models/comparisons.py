"""Comparisons on the wire."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from dynident_service.models.common import Asked, Computed, Identifier, Name, Shown


class ComparisonRequest(Asked):
    """Which model is held against which measurement."""

    identification_id: Identifier
    measurement_id: Identifier
    name: Name | None = None


class WorstStretch(Shown):
    """A stretch of time where a joint's residual is large."""

    model_config = ConfigDict(serialize_by_alias=True)

    joint: str
    start: float = Field(alias="from", description="s")
    end: float = Field(alias="to", description="s")
    rms: float = Field(description="N m or N")
    ratio: float = Field(description="Over the joint's own rms")


class ComparisonResult(Shown):
    """How far measured and predicted torque are apart."""

    joints: list[str]
    effort_units: list[str]
    n_samples: int
    start_time: float
    end_time: float
    rms: list[float | None]
    relative: list[float | None]
    relative_total: float | None
    worst: list[WorstStretch]


class ComparisonView(Computed[ComparisonRequest, ComparisonResult]):
    """A comparison."""


class Series(Shown):
    """One joint's signals over time, thinned for plotting so that extremes survive."""

    joint: str
    effort_unit: str
    n_samples: int = Field(description="How many there are in the stretch, of which these are shown")
    t: list[float]
    segment: list[int]
    measured: list[float]
    predicted: list[float]
    residual: list[float]
    band: list[float] = Field(description="Half-width of the 95 % band of the residual")
    q: list[float]
    dq: list[float]


class ResidualMap(Shown):
    """A joint's residual over one or two signals, in bins."""

    joint: str
    effort_unit: str
    x: str
    y: str | None
    x_edges: list[float]
    y_edges: list[float] | None
    mean: list[list[float | None]] = Field(description="[x bin][y bin]; null where a bin is empty")
    spread: list[list[float | None]] = Field(description="Standard deviation in the bin")
    count: list[list[int]]
