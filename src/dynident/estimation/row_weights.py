"""Robust weights (Huber, Tukey) with a robust scale, and weights of a group of rows by its noise.

Robust regression has weight functions by Huber and Tukey, and a scale that ignores outliers.
Huber's function has one minimum whatever the first estimate, but a gross outlier still pulls with a constant force.
Tukey's bisquare rejects it entirely, but has local minima near a poor first estimate. So Huber's comes first and
the bisquare starts from where it ends (Yohai 1987; Maronna, Martin and Yohai 2006, chapter 5). With the usual constants
both lose a twentieth of the efficiency of least squares where residuals are normal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation.least_squares import (
    EstimationError,
    ReweightedEquations,
    compute_rounding,
    floor_noise,
    measure_growth_of_terms,
    settle_noise,
    solve_ordinary,
)
from dynident.estimation.prior_information import PriorInformation
from dynident.estimation.residual_errors import compute_deviation
from dynident.estimation.row_groups import WeightedRows
from dynident.estimation.triangular_factors import EquationFactors, Reduction

# The usual constants, in standard deviations: an efficiency of 95 % where residuals are normal.
_HUBER, _BISQUARE = 1.345, 4.685
# Median absolute deviation of a normal distribution, in standard deviations.
_MEDIAN = 0.6744897501960817


@dataclass(frozen=True)
class Influence:
    """How a residual u, in units of its standard deviation, acts on the estimate.

    Parameters
    ----------
    weight, slope : callable
        w(u) = ψ(u) / u and ψ'(u), for arrays of any shape.
    """

    weight: Callable[[FloatArray], FloatArray]
    slope: Callable[[FloatArray], FloatArray]


def _huber_weight(u: FloatArray) -> FloatArray:
    return np.asarray(_HUBER / np.maximum(np.abs(u), _HUBER))


def _huber_slope(u: FloatArray) -> FloatArray:
    return np.asarray((np.abs(u) <= _HUBER).astype(np.float64))


def _bisquare_weight(u: FloatArray) -> FloatArray:
    inside = np.maximum(1.0 - (u / _BISQUARE) ** 2, 0.0)
    return np.asarray(inside**2)


def _bisquare_slope(u: FloatArray) -> FloatArray:
    square = (u / _BISQUARE) ** 2
    return np.asarray(np.where(square < 1.0, (1.0 - square) * (1.0 - 5.0 * square), 0.0))


HUBER = Influence(_huber_weight, _huber_slope)
BISQUARE = Influence(_bisquare_weight, _bisquare_slope)


def estimate_robust_scale(residuals: FloatArray) -> FloatArray:
    """Return the standard deviation about zero of residuals (m, n) per column, from their median size.

    A third of them may be outliers. NaN does not count; a column without any number has a scale of zero.
    """
    scale = np.zeros(residuals.shape[1])
    known = np.isfinite(residuals).any(axis=0)
    scale[known] = np.nanmedian(np.abs(residuals[:, known]), axis=0) / _MEDIAN
    return scale


# A few rounds are usual; the limit only ends a search that goes to and fro.
_MOST_ROUNDS = 20
_SETTLED = 0.01
"""Largest relative change of any noise in the last round: its effect is far below the estimates' own deviations."""


def estimate_group_weights(reduction: Reduction, known: PriorInformation | None = None) -> FloatArray:
    """Estimate the weights of rows with a weight of their own: the variance of the other rows over theirs, 1 at most.

    Both variances are residuals of the fit that weights all rows so. The weights are one where the equations do not
    know which rows these are, and where they cannot be solved: whoever solves them reports why.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.

    Returns
    -------
    (n,) array
        Weight of a squared residual of these rows relative to one of the other rows, in (0, 1].
    """
    weights = np.ones(len(reduction.equations))
    if not any(
        equation.weighted_rows is not None and equation.weighted_rows.counts.any() for equation in reduction.equations
    ):
        return weights
    # Blocks of time do not matter for the weights; one block makes every round cheaper.
    coarse = Reduction(reduction.n_columns, tuple(map(_merge_blocks, reduction.equations)), reduction.spans[:1])
    try:
        return _settle_group_weights(coarse, known)
    except EstimationError:
        return weights


def _settle_group_weights(coarse: Reduction, known: PriorInformation | None) -> FloatArray:
    """Estimate the weights as `estimate_group_weights`, of equations in one block in which all rows count alike."""
    n = len(coarse.equations)
    # Rows with a weight of their own, and the others, as equations by themselves: what changes is only their noise.
    parts = _split_groups(coarse)
    others, weighted = (equations.row_counts for equations in parts)
    apart = Reduction(coarse.n_columns, (*parts[0].equations, *parts[1].equations), coarse.spans)
    first = solve_ordinary(coarse, known)
    equations = ReweightedEquations.from_solution(apart, replace(first, noise=np.tile(first.noise, 2)))
    grow = measure_growth_of_terms(coarse, first.values)
    # Against prior knowledge exact data must not weigh without limit.
    floor = compute_rounding(coarse) if known is not None and known.has_rows else np.zeros(n)
    weights, values = np.ones(n), first.values

    def noise_of(values: FloatArray) -> FloatArray:
        of_others, of_weighted = equations.sum_squares(values).reshape(2, n)
        noise = floor_noise(compute_deviation(coarse, of_others + weights * of_weighted))
        return np.asarray(np.maximum(noise, floor) / grow(values))

    def values_of(noise: FloatArray) -> FloatArray:
        return equations.solve(np.concatenate([noise, noise / np.sqrt(weights)]))

    # Fixed point: weights give estimates, estimates give residuals of either kind of rows, and these give weights.
    for _ in range(_MOST_ROUNDS):
        _, values, _ = settle_noise(coarse, noise_of(values), noise_of, values_of)
        of_others, of_weighted = equations.sum_squares(values).reshape(2, n)
        both = (others > 0) & (weighted > 0) & (of_others > 0.0) & (of_weighted > 0.0)
        before, ratio = weights, np.ones(n)
        ratio[both] = (of_others[both] / others[both]) / (of_weighted[both] / weighted[both])
        # One at most: these rows are never better than the others, and a smaller residual of theirs is chance.
        weights = np.minimum(ratio, 1.0)
        # Weights are variances: twice the relative change of a standard deviation.
        if np.all(np.abs(weights - before) <= 2 * _SETTLED * before):
            break
    return weights


def _merge_blocks(equation: EquationFactors) -> EquationFactors:
    """Return the same equation in one block, all rows counting alike, without its interval rows."""
    counts = np.array([equation.counts.sum()])
    if equation.weighted_rows is None:
        return EquationFactors(equation.columns, equation.whole_factor[None], counts)
    others, group = equation.weighted_rows.whole_parts
    own = WeightedRows(group[None], np.array([equation.weighted_rows.count]), others[None])
    return EquationFactors.from_groups(equation.columns, own, counts, None)


def _split_groups(coarse: Reduction) -> tuple[Reduction, Reduction]:
    """Return the other rows and the weighted ones of equations in one block, as equations by themselves."""
    groups: tuple[list[EquationFactors], list[EquationFactors]] = ([], [])
    for equation in coarse.equations:
        rows = equation.weighted_rows
        count = 0 if rows is None else rows.count
        both = (equation.factors, 0.0 * equation.factors) if rows is None else (rows.others, rows.rows)
        for group, factors, size in zip(groups, both, (equation.counts - count, np.array([count])), strict=True):
            group.append(EquationFactors(equation.columns, factors, size))
    others, weighted = (Reduction(coarse.n_columns, tuple(group), coarse.spans) for group in groups)
    return others, weighted
