"""Every parameter day by day, with its interval."""

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
    """The parameters of a model, and of what it has got since, on each day.

    What a robot's days may differ in is free on each; the rest, which does not change, is known from the other days as
    well: a day's motion alone leaves friction less certain than it need be. A parameter of the rest has the value that
    the day gives by itself.

    Parameters
    ----------
    columns : those of the measure's W
    steps : all columns of the model and of what was found
    """
    own = tuple(dict.fromkeys(step.number for step in steps))
    first = {number: min(step.since for step in steps if step.number == number) for number in own}
    varies = np.array([effect_by_id(columns[k].effect).may_change for k in own])
    values, half = np.full((len(own), len(days)), np.nan), np.full((len(own), len(days)), np.nan)
    for d in range(len(days)):
        there = np.array([first[k] <= d for k in own])
        alone = reduction_of(days, [Stepped(k) for k in np.array(own)[there]], [d])
        others = _known(days, steps, [Stepped(k) for k in np.array(own)[there]], varies[there], d)
        for known, of in ((None, ~varies), (others, varies)):
            told = _told(alone, known)
            if told is None:
                continue
            chosen = np.flatnonzero(there & of)
            where = np.flatnonzero(of[there])
            values[chosen, d], half[chosen, d] = told[0][where], told[1][where]
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
    """Values (c,) and half-widths (c,) of their intervals; None where the data do not determine them."""
    try:
        solution = weighted(reduction, known)
    except EstimationError:
        return None
    return solution.values, statistics(reduction, solution).half_widths()


def _known(
    days: Sequence[Day], steps: Sequence[Stepped], wanted: Sequence[Stepped], varies: BoolArray, day: int
) -> Information | None:
    """What the other days say of the wanted parameters that do not vary."""
    which = [k for k in range(len(days)) if k != day]
    reduction = reduction_of(days, steps, which)
    seen = _seen(reduction)
    try:
        solution = weighted(reduction.select(seen))
    except EstimationError:
        return None
    covariance: Statistics = statistics(reduction.select(seen), solution)
    number = {steps[k].number: i for i, k in enumerate(seen) if not steps[k].since}
    steady = [k for k, one in enumerate(wanted) if not varies[k] and one.number in number]
    if not steady:
        return None
    places = np.array([number[wanted[k].number] for k in steady], dtype=np.intp)
    return known_values(
        solution.values[places],
        covariance.covariance[np.ix_(places, places)],
        np.array(steady, dtype=np.intp),
        len(wanted),
    )


def _seen(reduction: Reduction) -> IndexArray:
    """Columns that are not zero: a change of the day that is left out is none of the others."""
    size = np.zeros(reduction.n_columns)
    for equation in reduction.equations:
        size[equation.columns] += np.linalg.norm(equation.joined[:, :-1], axis=0)
    return np.flatnonzero(size > 0)
