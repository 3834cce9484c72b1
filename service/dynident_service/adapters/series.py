"""Series of days between the contract and the science."""

from __future__ import annotations

from dynident.diagnosis.series import Course, Series
from dynident_service.adapters.diagnoses import show_change
from dynident_service.adapters.effects import show_choice
from dynident_service.adapters.identifications import numbers
from dynident_service.models import series as wire


def describe_series(found: Series) -> wire.SeriesResult:
    """Describe a series of days for the wire."""
    return wire.SeriesResult(
        summary=found.summary,
        days=list(found.days),
        changes=[
            wire.SeriesChange(
                **show_change(one.change).model_dump(),
                since=found.days[one.since],
                earliest=found.days[one.earliest],
                latest=found.days[one.latest],
            )
            for one in found.changes
        ],
        missing=[show_choice(one) for one in found.missing],
        courses=[_course(one) for one in found.courses],
    )


def _course(one: Course) -> wire.Course:
    return wire.Course(
        parameter=one.parameter,
        effect=one.effect,
        joint=one.joint,
        unit=one.unit,
        values=numbers(one.values),
        lower=numbers(one.intervals[:, 0]),
        upper=numbers(one.intervals[:, 1]),
        varies=one.varies,
    )
