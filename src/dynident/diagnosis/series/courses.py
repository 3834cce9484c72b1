"""Estimate every parameter day by day, with its interval."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.series.days import Day
from dynident.diagnosis.series.result import Course
from dynident.diagnosis.series.steps import Stepped, reduction_of
from dynident.effects import Column, effect_by_id
from dynident.estimation import EstimationError, Reduction, Statistics, known_values, statistics, weighted
from dynident.estimation.information import Information
from dynident.progress import Progress


def courses(
    days: Sequence[Day], columns: Sequence[Column], steps: Sequence[Stepped], progress: Progress
) -> tuple[Course, ...]:
    """Estimate the parameters of a model, and of all changes since, on each day.

    Parameters that may change are free on each day. The others are known from the other days as well: the motion of one
    day
    alone would leave friction less certain than need be. A parameter that does not change gets the value of the day
    alone.

    Parameters
    ----------
    days : sequence of Day
    columns : sequence of Column
        Those of the measure's W.
    steps : sequence of Stepped
        All columns of the model and of the changes that were found.
    progress : Progress

    Returns
    -------
    tuple of Course
        One for each parameter, with nan on days that do not determine it.
    """
    own = tuple(dict.fromkeys(step.number for step in steps))
    first = {number: min(step.since for step in steps if step.number == number) for number in own}
    varies = np.array([effect_by_id(columns[k].effect).may_change for k in own])
    values, half = np.full((len(own), len(days)), np.nan), np.full((len(own), len(days)), np.nan)
    for d in range(len(days)):
        present = np.array([first[k] <= d for k in own])
        alone = reduction_of(days, [Stepped(k) for k in np.array(own)[present]], [d])
        others = _known(days, steps, [Stepped(k) for k in np.array(own)[present]], varies[present], d)
        # Solved twice: without the other days for what does not vary, so that its value stays that day's own, and with
        # them for what does.
        for known, selection in ((None, ~varies), (others, varies)):
            estimate = _told(alone, known)
            if estimate is None:
                continue
            rows = np.flatnonzero(present & selection)
            where = np.flatnonzero(selection[present])
            values[rows, d], half[rows, d] = estimate[0][where], estimate[1][where]
        progress((d + 1) / len(days), days[d].name)
    return tuple(
        Course(
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


def _told(reduction: Reduction, known: Information | None) -> tuple[FloatArray, FloatArray] | None:
    """Return values (c,) and half-widths (c,) of their intervals; None where the data do not determine them."""
    try:
        solution = weighted(reduction, known)
    except EstimationError:
        return None
    return solution.values, statistics(reduction, solution).half_widths()


def _known(
    days: Sequence[Day], steps: Sequence[Stepped], day_columns: Sequence[Stepped], varies: BoolArray, day: int
) -> Information | None:
    """Return what the other days say of the parameters of one day that do not vary; None where nothing."""
    which = [k for k in range(len(days)) if k != day]
    reduction = reduction_of(days, steps, which)
    nonzero = _seen(reduction)
    try:
        solution = weighted(reduction.select(nonzero))
    except EstimationError:
        return None
    # The estimate of the other days enters as a prior with its covariance, so that its uncertainty counts.
    covariance: Statistics = statistics(reduction.select(nonzero), solution)
    number = {steps[k].number: i for i, k in enumerate(nonzero) if not steps[k].since}
    steady = [k for k, column in enumerate(day_columns) if not varies[k] and column.number in number]
    if not steady:
        return None
    places = np.array([number[day_columns[k].number] for k in steady], dtype=np.intp)
    return known_values(
        solution.values[places],
        covariance.covariance[np.ix_(places, places)],
        np.array(steady, dtype=np.intp),
        len(day_columns),
    )


def _seen(reduction: Reduction) -> IndexArray:
    """Return the columns that are not zero: a change on the day that is left out has none on the others."""
    size = np.zeros(reduction.n_columns)
    for equation in reduction.equations:
        size[equation.columns] += np.linalg.norm(equation.joined[:, :-1], axis=0)
    return np.flatnonzero(size > 0)
