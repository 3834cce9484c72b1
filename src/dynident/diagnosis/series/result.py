"""What a series of days tells."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.arrays import FloatArray
from dynident.diagnosis.result import Change
from dynident.effects import EffectChoice


@dataclass(frozen=True)
class SeriesChange:
    """Something that differs from day `since` on, by number; the data cannot tell days `earliest` to `latest` apart."""

    change: Change
    since: int
    earliest: int
    latest: int


@dataclass(frozen=True, eq=False)
class Course:
    """One parameter day by day: `values` (d,), and `intervals` (d, 2) that hold the true one with 95 %.

    NaN where that day's motion does not determine it. `varies`: it is of what a robot's days differ in; all else about
    the robot is then taken from the other days too. If not, the day stands by itself.
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
    """A robot over d days: what changed and when, what the model lacks on all of them, every parameter's course."""

    days: tuple[str, ...]
    changes: tuple[SeriesChange, ...]
    missing: tuple[EffectChoice, ...]
    courses: tuple[Course, ...]
    summary: str
