"""Weights of rows at reversals, from their noise relative to that of the other rows."""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation.errors import compute_weighted_squares
from dynident.estimation.factors import EquationFactors, Reduction
from dynident.estimation.least_squares import EstimationError, weighted
from dynident.estimation.prior_information import PriorInformation
from dynident.estimation.qr import join_factors
from dynident.estimation.rest_and_reversal_rows import ReversalRows

# A few rounds are usual; the limit only ends a search that goes to and fro.
_MOST_ROUNDS = 20
_SETTLED = 0.01
"""Largest relative change of any noise in the last round: its effect is far below the estimates' own deviations."""


def estimate_reversal_weights(reduction: Reduction, known: PriorInformation | None = None) -> FloatArray:
    """Return the weights of rows at reversals: the variance of the other rows over theirs, 1 at most.

    Both variances are residuals of the fit that weights all rows so. The weights are one where the equations do not
    know their reversals, and where they cannot be solved: whoever solves them reports why.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.

    Returns
    -------
    (n,) array
        Weight of a squared residual at a reversal relative to one of the other rows, in (0, 1].
    """
    weights = np.ones(len(reduction.equations))
    if not any(
        equation.reversal_rows is not None and equation.reversal_rows.counts.any() for equation in reduction.equations
    ):
        return weights
    # Blocks of time do not matter for the weights; one block makes every round cheaper.
    coarse = Reduction(reduction.n_columns, tuple(map(_merge_blocks, reduction.equations)), reduction.spans[:1])
    # Fixed point: weights give estimates, estimates give residuals of either kind of rows, and these give weights.
    for _ in range(_MOST_ROUNDS):
        try:
            values = weighted(coarse.weight_reversals(weights), known).values
        except EstimationError:
            return np.ones(len(weights))
        before, weights = weights, _compute_weights(coarse, values)
        # Weights are variances: twice the relative change of a standard deviation.
        if np.all(np.abs(weights - before) <= 2 * _SETTLED * before):
            break
    return weights


def _merge_blocks(equation: EquationFactors) -> EquationFactors:
    """Return the same equation in one block, all rows counting alike, without its rows at rest."""
    counts = np.array([equation.counts.sum()])
    if equation.reversal_rows is None:
        return EquationFactors(equation.columns, equation.joint_factor[None], counts)
    turned = equation.reversal_rows
    own = ReversalRows(turned.row_group.factor[None], np.array([turned.count]), join_factors(turned.others)[None])
    return EquationFactors(equation.columns, own.weighted_factors, counts, None, own)


def _compute_weights(coarse: Reduction, values: FloatArray) -> FloatArray:
    """Return the ratio (n,) of the mean squared residual of the other rows to that at reversals, 1 at most."""
    # With a weight of zero at reversals, only the squares of the other rows remain.
    alike = compute_weighted_squares(coarse.weight_reversals(np.zeros(len(coarse.equations))), values)
    weights = []
    for equation, squares in zip(coarse.equations, alike, strict=True):
        turns = 0 if equation.reversal_rows is None else int(equation.reversal_rows.counts.sum())
        others = int(equation.counts.sum()) - turns
        own = 0.0 if equation.reversal_rows is None else equation.reversal_rows.sum_squares(values[equation.columns])
        # One at most: rows at reversals are never better than the others, and a smaller residual there is chance.
        has_both_kinds = turns and others and squares > 0.0
        weights.append(min(1.0, (squares / others) / (own / turns)) if has_both_kinds and own > 0.0 else 1.0)
    return np.array(weights)
