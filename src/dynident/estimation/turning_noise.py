"""Weights of rows at reversals, from their noise relative to that of the other rows."""

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
"""Largest relative change of any noise in the last round: its effect is far below the estimates' own deviations."""


def turning_weights(reduction: Reduction, known: Information | None = None) -> FloatArray:
    """Return the weights of rows at reversals: the variance of the other rows over theirs, 1 at most.

    Both variances are residuals of the fit that weights all rows so. The weights are one where the equations do not
    know
    their reversals, and where they cannot be solved: whoever solves them reports why.

    Parameters
    ----------
    reduction : Reduction
    known : Information, optional
        Prior knowledge.

    Returns
    -------
    (n,) array
    """
    weights = np.ones(len(reduction.equations))
    if not any(equation.turned is not None and equation.turned.counts.any() for equation in reduction.equations):
        return weights
    # Blocks of time do not matter for the weights; one block makes every round cheaper.
    coarse = Reduction(reduction.n_columns, tuple(map(_in_one, reduction.equations)), reduction.spans[:1])
    for _ in range(_MOST_ROUNDS):
        try:
            values = weighted(coarse.weighing_turns(weights), known).values
        except EstimationError:
            return np.ones(len(weights))
        before, weights = weights, _weights(coarse, values)
        # Weights are variances: twice the relative change of a standard deviation.
        if np.all(np.abs(weights - before) <= 2 * _SETTLED * before):
            break
    return weights


def _in_one(equation: EquationFactors) -> EquationFactors:
    """Return the same equation in one block, all rows counting alike, without its rows at rest."""
    counts = np.array([equation.counts.sum()])
    if equation.turned is None:
        return EquationFactors(equation.columns, equation.joined[None], counts)
    turned = equation.turned
    own = Turned(join(turned.others)[None], turned.in_one.factor[None], np.array([turned.count]))
    return EquationFactors(equation.columns, own.together, counts, None, own)


def _weights(coarse: Reduction, values: FloatArray) -> FloatArray:
    """Return the ratio (n,) of the mean squared residual of the other rows to that at reversals, 1 at most."""
    # With a weight of zero at reversals, only the squares of the other rows remain.
    alike = weighed_squares(coarse.weighing_turns(np.zeros(len(coarse.equations))), values)
    weights = []
    for equation, squares in zip(coarse.equations, alike, strict=True):
        turns = 0 if equation.turned is None else int(equation.turned.counts.sum())
        others = int(equation.counts.sum()) - turns
        own = 0.0 if equation.turned is None else equation.turned.squares(values[equation.columns])
        has_both_kinds = turns and others and squares > 0.0
        weights.append(min(1.0, (squares / others) / (own / turns)) if has_both_kinds and own > 0.0 else 1.0)
    return np.array(weights)
