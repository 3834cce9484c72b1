"""Columns that start on some day, without copies of the data: products of earlier days count as zero."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.accumulate import ConditionalRows, PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.candidates.products import Products, ProductStack
from dynident.diagnosis.monitoring.days import Day, Measure, PossibleChange
from dynident.effects import EffectChoice
from dynident.estimation import EquationFactors, Reduction, concatenate_reductions


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
        """Return the products (s, *shape) at these places, whose shapes are broadcast.

        Parameters
        ----------
        rows, columns : arrays of int
            Places of the two factors of each product, which broadcast.
        """
        products = super().take_products(self._places[rows], self._places[columns])
        both = np.maximum(self._since[rows], self._since[columns])
        day = self._day.reshape(-1, *([1] * both.ndim))
        return np.asarray(np.where(day >= both, products, 0.0))


def build_step_pool(measure: Measure, names: Sequence[str]) -> tuple[Pool, tuple[StepColumn, ...]]:
    """Build candidates for all changes from any day but the first, and say what each of their columns is.

    The pool's W says which columns there are and on which joints they act; it is never evaluated.

    Parameters
    ----------
    measure : Measure
        Columns of the days, and what may change.
    names : sequence of str
        Names of the days.

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

    Parameters
    ----------
    days : sequence of Day
        Days in their order.
    columns : sequence of StepColumn
        Columns of the pool.

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
        factors = np.concatenate([recorded_day.reduction.equations[j].factors for recorded_day in days])
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

    Parameters
    ----------
    days : sequence of Day
        Days in their order.
    columns : sequence of StepColumn
        Columns that the rows are to have.
    which : sequence of int or None
        Numbers of the days; all where left out.

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
