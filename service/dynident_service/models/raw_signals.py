"""Signals as they were recorded, on the wire."""

from __future__ import annotations

from pydantic import Field

from dynident_service.models.common import Shown


class RawSignals(Shown):
    """Signals of a measurement's file; nothing is filtered, mended or resampled."""

    units: dict[str, str] = Field(description="By signal; empty for a column of the file that is given as it stands")
    t: list[float | None] = Field(description="s")
    signals: dict[str, list[float | None]] = Field(description="As long as t; null where there is no number")
    n_samples: int = Field(description="How many there are from `from` to `to`, of which these are shown")


class StandstillsOfJoint(Shown):
    """When one joint stands."""

    joint: str
    standing: list[tuple[float, float]] = Field(description="Seconds of t, [from, to], one after another")


class Standstills(Shown):
    """When every joint of a measurement stands: there friction may hold any torque."""

    joints: list[StandstillsOfJoint]
