"""Series of days between the contract and the science."""

from __future__ import annotations

from dynident.diagnosis.series import Series, SeriesChange
from dynident_service.adapters.answers import shown
from dynident_service.adapters.diagnoses import show_change
from dynident_service.models import series as wire


def describe_series(found: Series) -> wire.SeriesResult:
    """Describe a series of days for the wire."""
    courses = [shown(wire.Course, one, lower=one.intervals[:, 0], upper=one.intervals[:, 1]) for one in found.courses]
    return shown(wire.SeriesResult, found, changes=[_change(found, one) for one in found.changes], courses=courses)


def _change(found: Series, one: SeriesChange) -> wire.SeriesChange:
    days = {name: found.days[getattr(one, name)] for name in ("since", "earliest", "latest")}
    return wire.SeriesChange(**show_change(one.change).model_dump(), **days)
