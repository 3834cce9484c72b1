"""Days differ by more than their samples tell: what varies from day to day widens the interval of a change."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from dynident.diagnosis.result import ChangedValue
from dynident.diagnosis.series.result import Course, SeriesChange


def widened(changes: Sequence[SeriesChange], courses: Sequence[Course]) -> tuple[SeriesChange, ...]:
    """The changes with intervals that hold what the days between two changes differ in, where that is more.

    A change is the mean of the days from it to the next one less that of the days before it to the last one; the spread
    of the days about such means, of all of them together, says how far that may be off (Student's t).
    """
    course_of = {course.parameter: course for course in courses}
    begun = {
        name: sorted({one.since for one in changes for value in _values(one) if value.parameter == name})
        for name in course_of
    }
    found = []
    for one in changes:
        main, *more = (
            _widened(value, one.since, begun.get(value.parameter, []), course_of.get(value.parameter))
            for value in _values(one)
        )
        found.append(replace(one, change=replace(one.change, main=main, more=tuple(more))))
    return tuple(found)


def _values(one: SeriesChange) -> tuple[ChangedValue, ...]:
    return one.change.main, *one.change.more


def _widened(value: ChangedValue, since: int, begun: Sequence[int], course: Course | None) -> ChangedValue:
    if course is None:
        return value
    days = np.flatnonzero(np.isfinite(course.values))
    part = np.searchsorted(np.array(begun), days, side="right")
    count = np.bincount(part, minlength=len(begun) + 1)
    means = np.bincount(part, course.values[days], minlength=len(begun) + 1) / np.maximum(count, 1)
    freedom = len(days) - int((count > 0).sum())
    here = begun.index(since) + 1
    if freedom < 1 or not count[here]:
        return value
    # Of something that was not there before, only the days that have it differ.
    share = 1.0 / count[here] + (1.0 / count[here - 1] if count[here - 1] else 0.0)
    spread = float(((course.values[days] - means[part]) ** 2).sum()) / freedom
    half = float(stdtrit(freedom, 0.975)) * float(np.sqrt(spread * share))
    low, high = value.interval
    half = max(half, 0.5 * (high - low))
    return replace(value, interval=(value.value - half, value.value + half))
