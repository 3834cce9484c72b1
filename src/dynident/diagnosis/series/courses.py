"""Estimate every parameter day by day, with its interval."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.series.days import Day
from dynident.diagnosis.series.result import ParameterTrack
from dynident.diagnosis.series.steps import StepColumn, combine_days
from dynident.effects import Column, get_effect
from dynident.estimation import EstimationError, Reduction, Statistics, build_prior, statistics, weighted
from dynident.estimation.information import PriorInformation
from dynident.progress import Progress


def estimate_tracks(
    days: Sequence[Day], columns: Sequence[Column], steps: Sequence[StepColumn], progress: Progress
) -> tuple[ParameterTrack, ...]:
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
