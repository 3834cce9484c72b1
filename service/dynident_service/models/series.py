"""Series of days on the wire."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from dynident_service.models.common import Computed, EffectChoice, Identifier, Shown, Wanted
from dynident_service.models.diagnoses import Change


class Day(Wanted):
    """The measurements of one day; without a name that of the first of them."""

    measurement_ids: Annotated[list[Identifier], Field(min_length=1, max_length=100)]


class SeriesRequest(Wanted):
    """Which robot is followed over which days."""

    identification_id: Identifier
    days: list[Day] = Field(min_length=1, max_length=1000, description="In their order; two at least with those before")
    continues: Identifier | None = Field(
        default=None, description="A series of the same model whose days come first; they are not read again."
    )


class SeriesChange(Change):
    """What differs from some day on; `runs` are the days that have it."""

    since: str = Field(description="The first day that has it")
    earliest: str = Field(description="From here on it would explain as much")
    latest: str = Field(description="Up to here")


class Course(Shown):
    """One parameter day by day; null where the motion of that day does not determine it."""

    parameter: str
    effect: str
    joint: str
    unit: str
    values: list[float | None]
    lower: list[float | None] = Field(description="Ends of the intervals that hold the true value in 95 of 100 cases")
    upper: list[float | None]
    varies: bool = Field(
        description="Of what a robot's days may differ in: all else is then known from the other days, too"
    )


class SeriesResult(Shown):
    """What has changed over the days, since when, and the course of every parameter."""

    summary: str
    days: list[str]
    changes: list[SeriesChange]
    missing: list[EffectChoice] = Field(description="What the model lacks on all days")
    courses: list[Course]


class SeriesView(Computed[SeriesRequest, SeriesResult]):
    """A series of days."""
