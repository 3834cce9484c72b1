"""Result types of the monitoring of a robot over days."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.array_types import FloatArray
from dynident.diagnosis.result import Change
from dynident.effects import EffectChoice


@dataclass(frozen=True)
class SeriesChange:
    """A change from some day on.

    Parameters
    ----------
    change : Change
        The change.
    since : int
        Number of the day from which on it is there.
    earliest : int
        First of the days that the data cannot tell from that day.
    latest : int
        Last of these days.
    """

    change: Change
    since: int
    earliest: int
    latest: int


@dataclass(frozen=True, eq=False)
class ParameterTrack:
    """One parameter day by day.

    Parameters
    ----------
    parameter : str
        Name of the parameter.
    effect : str
        Id of its effect.
    joint : str
        Name of the joint.
    unit : str
        Unit of the values.
    values : (d,)
        Value on each day; nan where the day's motion does not determine it.
    intervals : (d, 2)
        95 % intervals; nan likewise.
    varies : bool
        Whether the parameter may change from day to day. What may not is taken from the other days too, for those that
        may; its own value is that of the day by itself.
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
    """A robot over some days.

    Parameters
    ----------
    days : tuple of str
        Names of the d days.
    changes : tuple of SeriesChange
        What changed, and when.
    missing : tuple of EffectChoice
        What the model lacks on all days.
    courses : tuple of ParameterTrack
        Every parameter day by day.
    summary : str
        The result in a few sentences.
    """

    days: tuple[str, ...]
    changes: tuple[SeriesChange, ...]
    missing: tuple[EffectChoice, ...]
    courses: tuple[ParameterTrack, ...]
    summary: str
