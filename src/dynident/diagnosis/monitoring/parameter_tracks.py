"""Estimate each parameter day by day, and widen the intervals of changes by the variance between days.

Holds the types of a series, and columns that start on some day.

Columns that start on some day need no copies of the data: products of earlier days count as zero.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import stdtrit

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.candidates.inner_product_accumulation import ConditionalRows, PhasedProducts
from dynident.diagnosis.candidates.time_blocks_and_folds import Products, ProductStack
from dynident.diagnosis.diagnosis_result import Change, ChangedValue
from dynident.diagnosis.monitoring.reduced_days import Day, Measure, PossibleChange
from dynident.effects import Column, EffectChoice, get_effect
from dynident.estimation import (
    EquationFactors,
    EstimationError,
    Reduction,
    Statistics,
    build_prior,
    concatenate_reductions,
    solve_weighted,
    statistics,
)
from dynident.estimation.prior_information import PriorInformation
from dynident.estimation.qr_decomposition import concatenate_stacks
from dynident.progress import Progress


@dataclass(frozen=True)
class StepColumn:
    """A column that starts on some day.

    Parameters
    ----------
    number : int
        Number of the column in W of the measure.
    since : int
        Number of the day before which it is zero; 0 for all days.
    """

    number: int
    since: int = 0


def build_choice_since(possible: PossibleChange, since: int, names: Sequence[str]) -> EffectChoice:
    """Return what is there from a day on as a choice, whose runs are the days."""
    return replace(possible.choice, runs=tuple(names[since:]) if since else ())


class StepProductStack(ProductStack):
    """Products of one joint's columns, some of which start on some day.

    Parameters
    ----------
    values : (s, p + 1, p + 1)
    places : (v + 1,)
        Where each of the v columns, and Y behind them, stands in `values`.
    since : (v + 1,)
        The day from which on it is there.
    day : (s,)
        The day of every block of time.
    """

    def __init__(self, values: FloatArray, places: IndexArray, since: IndexArray, day: IndexArray) -> None:
        super().__init__(values)
        self._places, self._since, self._day = places, since, day

    @cached_property
    def total(self) -> FloatArray:
        """Products (v + 1, v + 1) over all blocks of time."""
        days = int(self._day.max(initial=0)) + 1
        each = np.array([self.values[self._day == k].sum(axis=0) for k in range(days)])
        # A product of two columns is not zero from the later of their first days on: a cumulative sum from the last day
        # backwards has all of these.
        later = np.cumsum(each[::-1], axis=0)[::-1]
        both = np.maximum(self._since[:, None], self._since)
        return np.asarray(later[both, self._places[:, None], self._places])

    def take_products(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (s, *shape) at these places, whose shapes are broadcast."""
        products = super().take_products(self._places[rows], self._places[columns])
        both = np.maximum(self._since[rows], self._since[columns])
        day = self._day.reshape(-1, *([1] * both.ndim))
        return np.asarray(np.where(day >= both, products, 0.0))


def build_step_pool(measure: Measure, names: Sequence[str]) -> tuple[Pool, tuple[StepColumn, ...]]:
    """Build candidates for all changes from any day but the first, and say what each of their columns is.

    The pool's W says which columns there are and on which joints they act; it is never evaluated.

    Returns
    -------
    tuple of Pool, tuple of StepColumn
        The candidates, and what each of their columns is.
    """
    wide = measure.observation
    n_wide = wide.n_columns
    changing = sorted({k for possible in measure.possible for k in possible.columns})
    columns, steps = list(wide.columns), [StepColumn(k) for k in range(n_wide)]
    rows, numbers = [wide.entry_rows], [wide.entry_columns]
    number_of: dict[StepColumn, int] = {column: k for k, column in enumerate(steps)}
    # Not from the first day on, which all others are compared with.
    for since in range(1, len(names)):
        for k in changing:
            acting = wide.entry_rows[wide.entry_columns == k]
            rows.append(acting)
            numbers.append(np.full(len(acting), len(columns), dtype=np.intp))
            number_of[StepColumn(k, since)] = len(columns)
            columns.append(replace(wide.columns[k], runs=tuple(names[since:])))
            steps.append(StepColumn(k, since))
    observation = replace(
        wide, columns=tuple(columns), entry_rows=np.concatenate(rows), entry_columns=np.concatenate(numbers)
    )
    places = [(possible, since) for since in range(1, len(names)) for possible in measure.possible]
    candidates = [_build_candidate(possible, since, names, number_of) for possible, since in places]
    candidates += [_build_candidate(possible, 0, names, number_of) for possible in measure.lasting]
    pool = Pool(observation, measure.model.n_parameters, tuple(candidates), tuple(names[1:]))
    return pool, tuple(steps)


def _build_candidate(
    possible: PossibleChange, since: int, names: Sequence[str], number_of: dict[StepColumn, int]
) -> Candidate:
    choice = build_choice_since(possible, since, names)
    columns = tuple(number_of[StepColumn(k, since)] for k in possible.columns)
    return Candidate(choice.effect, choice.joints, choice.shape, columns, choice.runs)


def gather_step_products(days: Sequence[Day], columns: Sequence[StepColumn]) -> PhasedProducts:
    """Compute inner products of the days' columns, with later ones zero before their day; the runs are the days.

    Returns
    -------
    PhasedProducts
        Products by block; there are no rows at reversals or beside halts.
    """
    day = np.repeat(np.arange(len(days)), [recorded_day.reduction.n_blocks for recorded_day in days])
    number = np.array([column.number for column in columns], dtype=np.intp)
    since = np.array([column.since for column in columns], dtype=np.intp)
    stacks, position, counts = [], [], []
    for j, equation in enumerate(days[0].reduction.equations):
        factors = concatenate_stacks([recorded_day.reduction.equations[j].factors for recorded_day in days])
        where = np.full(days[0].reduction.n_columns, -1, dtype=np.intp)
        where[equation.columns] = np.arange(len(equation.columns))
        have = np.flatnonzero(where[number] >= 0)
        places = np.append(where[number[have]], len(equation.columns))
        own = np.full(len(columns), -1, dtype=np.intp)
        own[have] = np.arange(len(have))
        # One array serves all steps: which blocks count for a column is decided when products are taken.
        values = factors.transpose(0, 2, 1) @ factors
        stacks.append((StepProductStack(values, places, np.append(since[have], 0), day),))
        position.append(own)
        counts.append(np.concatenate([recorded_day.reduction.equations[j].counts for recorded_day in days]))
    moving = Products(tuple(stacks), tuple(position), np.array(counts).T.astype(np.float64), day)
    nowhere = ConditionalRows((), np.zeros_like(moving.counts), np.zeros((len(columns), moving.n_joints), dtype=bool))
    return PhasedProducts(moving, nowhere, nowhere)


def combine_days(days: Sequence[Day], columns: Sequence[StepColumn], which: Sequence[int] | None = None) -> Reduction:
    """Return the reduced rows of some of the days.

    Returns
    -------
    Reduction
        The rows of these days, one after the other.
    """
    day_numbers = range(len(days)) if which is None else which
    return concatenate_reductions([_apply_steps(days[k].reduction, columns, k) for k in day_numbers])


def _apply_steps(reduction: Reduction, columns: Sequence[StepColumn], day: int) -> Reduction:
    """Return the reduction of one day with stepped columns instead of the measure's."""
    equations = []
    for equation in reduction.equations:
        where = {int(column): place for place, column in enumerate(equation.columns)}
        own = [k for k, column in enumerate(columns) if column.number in where]
        # A matrix of zeros and ones chooses the columns; its last place is that of Y.
        change = np.zeros((len(equation.columns) + 1, len(own) + 1))
        change[-1, -1] = 1.0
        for new, k in enumerate(own):
            if day >= columns[k].since:
                change[where[columns[k].number], new] = 1.0
        changed: EquationFactors = equation.mix_columns(change, np.array(own, dtype=np.intp))
        equations.append(changed)
    return Reduction(len(columns), tuple(equations), reduction.spans)


@dataclass(frozen=True)
class SeriesChange:
    """A change from some day on.

    Parameters
    ----------
    change : Change
        The change.
    since : int
        Number of the day from which on it is there.
    earliest : int
        First of the days that the data cannot tell from that day.
    latest : int
        Last of these days.
    """

    change: Change
    since: int
    earliest: int
    latest: int


@dataclass(frozen=True, eq=False)
class ParameterTrack:
    """One parameter day by day.

    Parameters
    ----------
    parameter : str
        Name of the parameter.
    effect : str
        Id of its effect.
    joint : str
        Name of the joint.
    unit : str
        Unit of the values.
    values : (d,)
        Value on each day; nan where the day's motion does not determine it.
    intervals : (d, 2)
        95 % intervals; nan likewise.
    varies : bool
        Whether the parameter may change from day to day. What may not is taken from the other days too, for those that
        may; its own value is that of the day by itself.
    """

    parameter: str
    effect: str
    joint: str
    unit: str
    values: FloatArray
    intervals: FloatArray
    varies: bool


@dataclass(frozen=True, eq=False)
class Series:
    """A robot over some days.

    Parameters
    ----------
    days : tuple of str
        Names of the d days.
    changes : tuple of SeriesChange
        What changed, and when.
    missing : tuple of EffectChoice
        What the model lacks on all days.
    courses : tuple of ParameterTrack
        Every parameter day by day.
    summary : str
        The result in a few sentences.
    """

    days: tuple[str, ...]
    changes: tuple[SeriesChange, ...]
    missing: tuple[EffectChoice, ...]
    courses: tuple[ParameterTrack, ...]
    summary: str


def widen_intervals(changes: Sequence[SeriesChange], courses: Sequence[ParameterTrack]) -> tuple[SeriesChange, ...]:
    """Widen the intervals of changes where the days between two changes differ by more than the intervals allow.

    A change is the mean of the days from it to the next one minus that of the days before it back to the last one. The
    pooled spread of the days about such means says how far it may be off (Student's t).

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
        solution = solve_weighted(reduction, known)
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
        solution = solve_weighted(reduction.select_columns(nonzero))
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
        size[equation.columns] += np.linalg.norm(equation.whole_factor[:, :-1], axis=0)
    return np.flatnonzero(size > 0)
