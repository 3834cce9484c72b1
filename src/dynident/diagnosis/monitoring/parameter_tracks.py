"""Estimate every parameter day by day, and widen the intervals of changes by the variance between days."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.monitoring.days import Day
from dynident.diagnosis.monitoring.result import ParameterTrack, SeriesChange
from dynident.diagnosis.monitoring.step_columns import StepColumn, combine_days
from dynident.diagnosis.result import ChangedValue
from dynident.effects import Column, get_effect
from dynident.estimation import EstimationError, Reduction, Statistics, build_prior, statistics, weighted
from dynident.estimation.prior_information import PriorInformation
from dynident.progress import Progress


def widen_intervals(changes: Sequence[SeriesChange], courses: Sequence[ParameterTrack]) -> tuple[SeriesChange, ...]:
    """Widen the intervals of changes where the days between two changes differ by more than the intervals allow.

    A change is the mean of the days from it to the next one minus that of the days before it back to the last one. The
    pooled spread of the days about such means says how far it may be off (Student's t).

    Parameters
    ----------
    changes : sequence of SeriesChange
        The changes, with intervals from the rows alone.
    courses : sequence of ParameterTrack
        Every parameter day by day.

    Returns
    -------
    tuple of SeriesChange
        The changes in the same order, none of them with a narrower interval.
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
    # The number of changes up to each day: the days between two changes form a period.
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
    # Never narrower: a few days that happen to agree do not make the rows less noisy.
    half = max(half, 0.5 * (high - low))
    return replace(value, interval=(value.value - half, value.value + half))


def estimate_tracks(
    days: Sequence[Day], columns: Sequence[Column], steps: Sequence[StepColumn], progress: Progress
) -> tuple[ParameterTrack, ...]:
    """Estimate the parameters of a model, and of all changes since, on each day.

    Parameters that may change are free on each day. The others are known from the other days as well: the motion of one
    day alone would leave friction less certain than need be. A parameter that does not change gets the value of the
    day alone.

    Parameters
    ----------
    days : sequence of Day
        Days in their order.
    columns : sequence of Column
        Columns of W of the measure.
    steps : sequence of StepColumn
        All columns of the model and of the changes that were found.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    tuple of ParameterTrack
        One for each parameter, with nan on days that do not determine it.
    """
    own = tuple(dict.fromkeys(step.number for step in steps))
    first = {number: min(step.since for step in steps if step.number == number) for number in own}
    varies = np.array([get_effect(columns[k].effect).may_change for k in own])
    values, half = np.full((len(own), len(days)), np.nan), np.full((len(own), len(days)), np.nan)
    for d in range(len(days)):
        present = np.array([first[k] <= d for k in own])
        alone = combine_days(days, [StepColumn(k) for k in np.array(own)[present]], [d])
        others = _estimate_from_other_days(
            days, steps, [StepColumn(k) for k in np.array(own)[present]], varies[present], d
        )
        # Solved twice: without the other days for what does not vary, so that its value stays that day's own, and with
        # them for what does.
        for known, selection in ((None, ~varies), (others, varies)):
            estimate = _estimate_day(alone, known)
            if estimate is None:
                continue
            rows = np.flatnonzero(present & selection)
            where = np.flatnonzero(selection[present])
            values[rows, d], half[rows, d] = estimate[0][where], estimate[1][where]
        progress((d + 1) / len(days), days[d].name)
    return tuple(
        ParameterTrack(
            columns[k].name,
            columns[k].effect,
            columns[k].link,
            columns[k].unit,
            values[i],
            np.column_stack([values[i] - half[i], values[i] + half[i]]),
            bool(varies[i]),
        )
        for i, k in enumerate(own)
    )


def _estimate_day(reduction: Reduction, known: PriorInformation | None) -> tuple[FloatArray, FloatArray] | None:
    """Return values (c,) and half-widths (c,) of their intervals; None where the data do not determine them."""
    try:
        solution = weighted(reduction, known)
    except EstimationError:
        return None
    return solution.values, statistics(reduction, solution).half_widths()


def _estimate_from_other_days(
    days: Sequence[Day], steps: Sequence[StepColumn], day_columns: Sequence[StepColumn], varies: BoolArray, day: int
) -> PriorInformation | None:
    """Return what the other days say of the parameters of one day that do not vary; None where nothing."""
    which = [k for k in range(len(days)) if k != day]
    reduction = combine_days(days, steps, which)
    # Columns of zeros would make the equations singular.
    nonzero = _find_nonzero_columns(reduction)
    try:
        solution = weighted(reduction.select_columns(nonzero))
    except EstimationError:
        return None
    # The estimate of the other days enters as a prior with its covariance, so that its uncertainty counts.
    covariance: Statistics = statistics(reduction.select_columns(nonzero), solution)
    number = {steps[k].number: i for i, k in enumerate(nonzero) if not steps[k].since}
    steady = [k for k, column in enumerate(day_columns) if not varies[k] and column.number in number]
    if not steady:
        return None
    places = np.array([number[day_columns[k].number] for k in steady], dtype=np.intp)
    return build_prior(
        solution.values[places],
        covariance.covariance[np.ix_(places, places)],
        np.array(steady, dtype=np.intp),
        len(day_columns),
    )


def _find_nonzero_columns(reduction: Reduction) -> IndexArray:
    """Return the columns that are not zero: a change on the day that is left out has none on the others."""
    size = np.zeros(reduction.n_columns)
    for equation in reduction.equations:
        size[equation.columns] += np.linalg.norm(equation.joint_factor[:, :-1], axis=0)
    return np.flatnonzero(size > 0)
