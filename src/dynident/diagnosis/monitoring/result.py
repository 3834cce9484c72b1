"""Result types of the monitoring of a robot over days."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.array_types import FloatArray
from dynident.diagnosis.result import Change
from dynident.effects import EffectChoice


@dataclass(frozen=True)
class SeriesChange:
    """A change from day `since` on, by number; the data cannot tell the days `earliest` to `latest` apart."""

    change: Change
    since: int
    earliest: int
    latest: int


@dataclass(frozen=True, eq=False)
class ParameterTrack:
    """One parameter day by day: `values` (d,), and 95 % `intervals` (d, 2).

    Both are nan where that day's motion does not determine it. `varies`: the parameter may change from day to day; what
    does
    not is then taken from the other days too. If not, the value is that of the day by itself.
    """

    parameter: str
    effect: str
    joint: str
    unit: str
    values: FloatArray
    intervals: FloatArray
    varies: bool


@dataclass(frozen=True, eq=False)
class Series:
    """A robot over d days: what changed and when, what the model lacks on all of them, and every parameter's values."""

    days: tuple[str, ...]
    changes: tuple[SeriesChange, ...]
    missing: tuple[EffectChoice, ...]
    courses: tuple[ParameterTrack, ...]
    summary: str
