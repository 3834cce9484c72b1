"""Widen the intervals of changes by the variance between days, where days differ by more than their samples tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from dynident.diagnosis.result import ChangedValue
from dynident.diagnosis.series.result import ParameterTrack, SeriesChange


def widen_intervals(changes: Sequence[SeriesChange], courses: Sequence[ParameterTrack]) -> tuple[SeriesChange, ...]:
    """Widen the intervals of changes where the days between two changes differ by more than the intervals allow.

    A change is the mean of the days from it to the next one minus that of the days before it back to the last one. The
    pooled spread of the days about such means says how far it may be off (Student's t).

    Parameters
    ----------
    changes : sequence of SeriesChange
    courses : sequence of Course

    Returns
    -------
    tuple of SeriesChange
    """
    course_of = {course.parameter: course for course in courses}
    begun = {
        name: sorted({change.since for change in changes for value in _list_values(change) if value.parameter == name})
        for name in course_of
    }
    widened_changes = []
    for change in changes:
        main, *more = (
            _widen_interval(value, change.since, begun.get(value.parameter, []), course_of.get(value.parameter))
            for value in _list_values(change)
        )
        widened_changes.append(replace(change, change=replace(change.change, main=main, more=tuple(more))))
    return tuple(widened_changes)


def _list_values(change: SeriesChange) -> tuple[ChangedValue, ...]:
    return change.change.main, *change.change.more


def _widen_interval(
    value: ChangedValue, since: int, begun: Sequence[int], course: ParameterTrack | None
) -> ChangedValue:
    if course is None:
        return value
    days = np.flatnonzero(np.isfinite(course.values))
    period = np.searchsorted(np.array(begun), days, side="right")
    count = np.bincount(period, minlength=len(begun) + 1)
    means = np.bincount(period, course.values[days], minlength=len(begun) + 1) / np.maximum(count, 1)
    # One degree of freedom goes for the mean of each period between two changes.
    freedom = len(days) - int((count > 0).sum())
    index = begun.index(since) + 1
    if freedom < 1 or not count[index]:
        return value
    # Of something that was not there before, only the days that have it differ.
    share = 1.0 / count[index] + (1.0 / count[index - 1] if count[index - 1] else 0.0)
    spread = float(((course.values[days] - means[period]) ** 2).sum()) / freedom
    half = float(stdtrit(freedom, 0.975)) * float(np.sqrt(spread * share))
    low, high = value.interval
    half = max(half, 0.5 * (high - low))
    return replace(value, interval=(value.value - half, value.value + half))
