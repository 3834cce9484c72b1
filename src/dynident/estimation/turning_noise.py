"""The noise of rows where joints turn round, beside that of the others: what either kind is weighed by."""

from __future__ import annotations

import numpy as np

from dynident.arrays import FloatArray
from dynident.estimation.factors import EquationFactors, Reduction
from dynident.estimation.information import Information
from dynident.estimation.least_squares import EstimationError, weighed_squares, weighted
from dynident.estimation.triangles import join
from dynident.estimation.turned import Turned

_MOST_ROUNDS = 20
_SETTLED = 0.01
"""Share by which no noise changes any more: what it changes in the estimates is far below their own deviations."""


def turning_weights(reduction: Reduction, known: Information | None = None) -> FloatArray:
    """(n,): what rows at which joints turn round count for: the others' variance over theirs, 1 at most.

    Either is what a fit leaves that weighs all rows so. Ones where joints are not told to turn round, and where no fit
    is to be had: whoever solves the equations says why.
    """
    weights = np.ones(len(reduction.equations))
    if not any(equation.turned is not None and equation.turned.counts.any() for equation in reduction.equations):
        return weights
    coarse = Reduction(reduction.n_columns, tuple(map(_in_one, reduction.equations)), reduction.spans[:1])
    for _ in range(_MOST_ROUNDS):
        try:
            values = weighted(coarse.weighing_turns(weights), known).values
        except EstimationError:
            return np.ones(len(weights))
        before, weights = weights, _weights(coarse, values)
        if np.all(np.abs(weights - before) <= 2 * _SETTLED * before):
            break
    return weights


def _in_one(equation: EquationFactors) -> EquationFactors:
    """The same in one stretch, all rows alike, without what is beside them."""
    counts = np.array([equation.counts.sum()])
    if equation.turned is None:
        return EquationFactors(equation.columns, equation.joined[None], counts)
    turned = equation.turned
    own = Turned(join(turned.others)[None], turned.in_one.factor[None], np.array([turned.count]))
    return EquationFactors(equation.columns, own.together, counts, None, own)


def _weights(coarse: Reduction, values: FloatArray) -> FloatArray:
    alike = weighed_squares(coarse.weighing_turns(np.zeros(len(coarse.equations))), values)
    found = []
    for equation, squares in zip(coarse.equations, alike, strict=True):
        turns = 0 if equation.turned is None else int(equation.turned.counts.sum())
        others = int(equation.counts.sum()) - turns
        own = 0.0 if equation.turned is None else equation.turned.squares(values[equation.columns])
        told = turns and others and squares > 0.0
        found.append(min(1.0, (squares / others) / (own / turns)) if told and own > 0.0 else 1.0)
    return np.array(found)
