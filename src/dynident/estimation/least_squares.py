"""Ordinary and weighted least squares from factors [12.5], rank checks, noise of each equation.

Holds the most rounds of weighting, and when weights count as settled.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.linalg import lapack, solve_triangular

from dynident.array_types import FloatArray, IndexArray
from dynident.errors import DynidentError
from dynident.estimation.prior_information import PriorInformation, Solution
from dynident.estimation.qr_decomposition import compute_r_factor, pad_to_square
from dynident.estimation.residual_correlation import compute_correlation_factors, join_dependent_blocks
from dynident.estimation.residual_errors import compute_deviation, compute_fitted_errors, compute_residual_noise
from dynident.estimation.triangular_factors import EquationFactors, Reduction

Fit = TypeVar("Fit")

MOST_ROUNDS = 20
"""Most rounds that estimate the noise of every equation; on sound data the third changes no visible digit."""

WEIGHTS_SETTLED = 1e-6
"""Largest relative change of any noise in the last round: its effect is far below the estimates' deviations."""

# Smallest part of a column of W that must be new against the columns before it, relative to the column's norm.
_SINGULAR = 1e-12
# Residual of exact data relative to what was measured: below it there is only rounding, which no iteration settles.
_ROUNDING = 1e-10
# Largest ratio of weights that normal equations are solved with: it leaves half of the digits.
_WIDEST = 1e8


class EstimationError(DynidentError):
    """Error: the equations do not determine the parameters.

    Parameters
    ----------
    detail : str
        What is wrong with these data, and what to do about it.
    pointer, title : str, optional
        JSON pointer to the cause in the caller's request, and short name of the kind of error.
    """


def build_weighted_factor(reduction: Reduction, noise: FloatArray, known: PriorInformation | None = None) -> FloatArray:
    """Return the triangular factor of [W | Y] over all equations, together with prior knowledge.

    Parameters
    ----------
    reduction, noise : Reduction, (n,)
        The equations as triangular factors, and the standard deviation of each one's residual, by which it is divided.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.

    Returns
    -------
    (c + 1, c + 1) array
        Upper triangular factor R with RᵀR = [W | Y]ᵀ[W | Y] of the weighted rows; Y is the last column.
    """
    c = reduction.n_columns
    parts = [np.zeros((0, c + 1)) if known is None else known.rows]
    for equation, sigma in zip(reduction.equations, noise, strict=True):
        k = len(equation.columns)
        if not len(equation.counts):
            continue
        wide = np.zeros((k + 1, c + 1))
        wide[:, equation.columns] = equation.whole_factor[:, :k] / sigma
        wide[:, c] = equation.whole_factor[:, k] / sigma
        parts.append(wide)
    stacked = np.concatenate(parts)
    # Too few rows still give a square factor, so that the rank check reports the problem.
    if len(stacked) < c + 1:
        stacked = np.pad(stacked, [(0, c + 1 - len(stacked)), (0, 0)])
    return compute_r_factor(stacked)


def solve(reduction: Reduction, noise: FloatArray, known: PriorInformation | None = None) -> Solution:
    """Solve [12.5] with every equation weighted by 1 / noise.

    Parameters
    ----------
    reduction, noise : Reduction, (n,)
        The equations as triangular factors, and the standard deviation of each one's residual, by which it is divided.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.

    Returns
    -------
    Solution
        The estimates, with the noise as it was given.

    Raises
    ------
    EstimationError
        Where there are fewer rows than parameters, or W does not have full rank.
    """
    c = reduction.n_columns
    check_rows(reduction.n_rows, c, known)
    r = build_weighted_factor(reduction, noise, known)
    factor = r[:c, :c]
    if known is None or known.held is None:
        check_rank(factor, _SINGULAR)
        return Solution(solve_triangular(factor, r[:c, c]), noise, factor, known)
    small, where = move_held_columns(r, known), ~known.is_held
    check_rank(small[:-1, :-1], _SINGULAR)
    values = known.restore_held(solve_triangular(small[:-1, :-1], small[:-1, -1]))
    return Solution(values, noise, factor, known, np.eye(c)[:, where])


def move_held_columns(r: FloatArray, known: PriorInformation | None) -> FloatArray:
    """Move the torque of parameters that are held to the right-hand side.

    Parameters
    ----------
    r : (c + 1, c + 1)
        Triangular factor of [W | Y].
    known : PriorInformation, optional
        Names the parameters that are held, and their values.

    Returns
    -------
    (f + 1, f + 1) array
        Triangular factor of the other columns and what is left of Y.
    """
    if known is None or known.held is None:
        return r
    where = known.is_held
    rest = r[:, -1] - r[:, :-1][:, where] @ known.held[where]
    return pad_to_square(compute_r_factor(np.column_stack([r[:, :-1][:, ~where], rest])))


def check_rows(n_rows: int, n_parameters: int, known: PriorInformation | None) -> None:
    """Raise `EstimationError` where there are fewer rows, prior knowledge included, than parameters."""
    if n_rows + (0 if known is None else len(known.right) + int(known.is_held.sum())) <= n_parameters:
        raise EstimationError(
            f"{n_rows} equations cannot determine {n_parameters} parameters; use a longer recording or wider windows",
            pointer="/recordings",
            title="Too few samples",
        )


def check_rank(factor: FloatArray, least: float, of: str = "") -> None:
    """Raise `EstimationError` where a triangular factor (c, c) of W is singular.

    `least` is the smallest part of a column that must be independent of the columns before it; `of` says whose W it is.
    """
    scales = np.linalg.norm(factor, axis=0)
    # A diagonal entry of R is the part of its column that is orthogonal to the columns before it.
    if np.any(scales == 0) or np.any(np.abs(np.diag(factor)) <= least * scales):
        raise EstimationError(
            f"the observation matrix{of} does not have full rank on these data",
            pointer="/effects",
            title="Not identifiable",
        )


def solve_ordinary(reduction: Reduction, known: PriorInformation | None = None) -> Solution:
    """Solve by ordinary least squares: all equations count alike.

    Prior knowledge is weighed against the common noise of the equations, with independent samples counted.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.

    Returns
    -------
    Solution
        The estimates; `noise` is the same for all equations, and one where there is no prior knowledge.

    Raises
    ------
    EstimationError
        As in `solve`.
    """
    alike = np.ones(len(reduction.equations))
    if known is None or not known.has_rows:
        return solve(reduction, alike, known)
    counts = reduction.row_counts

    # The mean variance over all rows; equations still count alike, only prior knowledge is weighed against it.
    def compute_common_noise(joined: Reduction, solution: Solution) -> FloatArray:
        doubt = compute_correlated_noise(reduction, solution, joined)
        return float(np.sqrt(np.sum(counts * doubt**2) / max(float(counts.sum()), 1.0))) * alike

    first = solve(reduction, alike, known)
    # The first weights know no unit: only the second fit weighs the prior by the size of its residuals.
    second = solve(reduction, compute_common_noise(join_dependent_blocks(reduction, first), first), known)
    return _iterate_against_prior(reduction, second, compute_common_noise)


def solve_weighted(reduction: Reduction, known: PriorInformation | None = None) -> Solution:
    """Solve by weighted least squares: each equation is divided by the standard deviation of its own residual.

    With prior knowledge, each row counts for as much as it is worth as an independent sample.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.

    Returns
    -------
    Solution
        The estimates and the noise that they were weighted by; `converged` tells whether that noise has settled.

    Raises
    ------
    EstimationError
        As in `solve`.
    """
    # Terms of homogeneous equations are measured by ordinary least squares alone.
    first = solve_ordinary(reduction, known)
    grow = measure_growth_of_terms(reduction, first.values)
    # Equations are weighted by their residuals; against prior knowledge, correlated rows count for less.
    if known is not None and known.has_rows:
        return _iterate_against_prior(
            reduction,
            first,
            lambda joined, fit: compute_correlated_noise(reduction, fit, joined) / grow(fit.values),
        )
    equations = ReweightedEquations.from_solution(reduction, first)

    def noise_of(values: FloatArray) -> FloatArray:
        return compute_noise_levels(reduction, values) / grow(values)

    noise, _, has_settled = settle_noise(reduction, noise_of(first.values), noise_of, equations.solve)
    return replace(solve(reduction, noise, known), converged=has_settled)


def measure_growth_of_terms(reduction: Reduction, first: FloatArray) -> Callable[[FloatArray], FloatArray | float]:
    """Return a function of parameters (c,): how many times those of `first` the terms of homogeneous equations are.

    The residual of Wχ = 0 shrinks with χ: weighted by it alone, such an equation would draw χ to zero.
    """
    if not any(_is_homogeneous(equation) for equation in reduction.equations):
        return lambda values: 1.0
    sizes = _measure_terms(reduction, first)
    return lambda values: _measure_terms(reduction, values) / sizes


def _is_homogeneous(equation: EquationFactors) -> bool:
    """Return whether an equation is Wχ = 0 throughout, as of a base that nothing touches."""
    return bool(equation.whole_factor[:, :-1].any() and not equation.whole_factor[:, -1].any())


def _measure_terms(reduction: Reduction, values: FloatArray) -> FloatArray:
    """Return the size (n,) of the terms of each homogeneous equation, √Σ χ_k² |W_k|²; 1 for the other equations."""
    sizes = np.ones(len(reduction.equations))
    for k, equation in enumerate(reduction.equations):
        if _is_homogeneous(equation):
            sizes[k] = np.linalg.norm(equation.whole_factor[:, :-1] * values[equation.columns]) or 1.0
    return sizes


def _iterate_against_prior(
    reduction: Reduction, first: Solution, noise_of: Callable[[Reduction, Solution], FloatArray]
) -> Solution:
    """Solve and estimate the noise in turn until the noise settles; it depends on the fit as a whole."""
    # Decided once: near the threshold, blocks that are joined could move the fit to where they are not, and back.
    joined = join_dependent_blocks(reduction, first)

    def solve_again(noise: FloatArray) -> Solution:
        return solve(reduction, noise, first.known)

    _, fit, has_settled = settle_noise(
        reduction, noise_of(joined, first), lambda fit: noise_of(joined, fit), solve_again
    )
    return replace(fit, converged=has_settled)


def settle_noise(
    reduction: Reduction, noise: FloatArray, noise_of: Callable[[Fit], FloatArray], fit_of: Callable[[FloatArray], Fit]
) -> tuple[FloatArray, Fit, bool]:
    """Estimate noise (n,) from a fit, or its values alone, and this from the noise in turn, until it settles (IRLS).

    Returns
    -------
    tuple of (n,), fit, bool
        The noise, the fit with it, and whether it has settled.
    """
    for _ in range(MOST_ROUNDS):
        fit = fit_of(noise)
        before, noise = noise, noise_of(fit)
        if are_weights_settled(reduction, before, noise):
            return before, fit, True
    return before, fit, False


@dataclass(frozen=True, eq=False)
class ReweightedEquations:
    """Normal equations of changed weights, about a solution and in coordinates in which it has WᵀW = 1.

    There the condition number is at most the ratio of the weights, so that nothing is lost by squaring it.

    Parameters
    ----------
    reduction, start : Reduction, Solution
        The equations, and a solution of them with any noise.
    free : (f,)
        Numbers of the parameters that are not held.
    factor : (f, f)
        Triangular factor R of its weighted W, of these parameters.
    rows, first : (r, c + 1), (n + 1,)
        [W | Y] of all equations and of prior knowledge, as they were weighted, and where the rows of each begin.
    grams, moments : (n + 1, f, f), (n + 1, f)
        ZᵀZ and Zᵀρ of every equation and of prior knowledge, as they were weighted, with Z = W R⁻¹.
    """

    reduction: Reduction
    start: Solution
    free: IndexArray
    factor: FloatArray
    rows: FloatArray
    first: IndexArray
    grams: FloatArray
    moments: FloatArray

    @classmethod
    def from_solution(cls, reduction: Reduction, start: Solution) -> ReweightedEquations:
        """Take a solution apart."""
        free, known = np.flatnonzero(~start.is_held), start.known
        factor = start.factor if start.free is None else compute_r_factor(start.factor[:, free])
        sizes = [len(equation.columns) + 1 for equation in reduction.equations]
        rows = np.zeros((sum(sizes) + (0 if known is None else len(known.right)), reduction.n_columns + 1))
        ends = np.cumsum([0, *sizes])
        for equation, sigma, first in zip(reduction.equations, start.noise, ends, strict=False):
            place = slice(first, first + len(equation.columns) + 1)
            rows[place, equation.columns] = equation.whole_factor[:, :-1] / sigma
            rows[place, -1] = equation.whole_factor[:, -1] / sigma
        if known is not None:
            rows[ends[-1] :] = known.rows
        residual = rows[:, -1] - rows[:, :-1] @ start.values
        z = solve_triangular(factor, rows[:, free].T, trans="T").T
        parts = [slice(a, b) for a, b in zip(ends, [*ends[1:], len(rows)], strict=True)]
        grams = np.array([z[part].T @ z[part] for part in parts])
        moments = np.array([residual[part] @ z[part] for part in parts])
        return cls(reduction, start, free, factor, rows, ends, grams, moments)

    def solve(self, noise: FloatArray) -> FloatArray:
        """Return the estimates (c,) with other noise (n,)."""
        weights = np.append((self.start.noise / noise) ** 2, 1.0)
        if len(self.free) and weights.max() <= _WIDEST * weights.min():
            gram = (weights @ self.grams.reshape(len(weights), -1)).reshape(self.factor.shape)
            # Not by SciPy's functions: for systems this small their checks take longer than the solution.
            _, change, failed = lapack.dposv(gram, weights @ self.moments)
            if not failed:
                values = self.start.values.copy()
                values[self.free] += lapack.dtrtrs(self.factor, change)[0]
                return values
        # Weights differ too much for normal equations, or nothing is free.
        return solve(self.reduction, noise, self.start.known).values

    def sum_squares(self, values: FloatArray) -> FloatArray:
        """Return the sum of squared residuals (n,) of every equation."""
        rows = self.rows[: self.first[-1]]
        residual = rows[:, -1] - rows[:, :-1] @ values
        return np.asarray(np.add.reduceat(residual * residual, self.first[:-1]) * self.start.noise**2)


def are_weights_settled(reduction: Reduction, before: FloatArray, after: FloatArray) -> bool:
    """Return whether the noise has stopped changing, or is no more than rounding of exact data.

    Parameters
    ----------
    reduction : Reduction
        The equations, one a joint or of another equation type.
    before, after : (n,)
        Noise of every equation before and after a round of weighting.

    Returns
    -------
    bool
    """
    limit = np.maximum(WEIGHTS_SETTLED * before, compute_rounding(reduction))
    return bool(np.all(np.abs(after - before) <= limit))


def compute_rounding(reduction: Reduction) -> FloatArray:
    """Return the noise (n,) of every equation that rounding leaves of exact data."""
    return _ROUNDING * reduction.measured_sizes / np.sqrt(np.maximum(reduction.row_counts, 1.0))


def compute_correlated_noise(reduction: Reduction, solution: Solution, joined: Reduction | None = None) -> FloatArray:
    """Return the noise (n,) of every equation, raised by the correlation of its rows.

    Prior knowledge is weighed against it. It is at least what rounding leaves of the measured values, lest exact data
    outweigh prior knowledge without limit.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The equations, and the estimate whose residuals are taken.
    joined : Reduction, optional
        As `compute_correlation_factors` takes it.
    """
    noise = compute_noise_levels(reduction, solution.values)
    factors = compute_correlation_factors(reduction, solution, joined)
    return np.maximum(noise * np.sqrt(factors), compute_rounding(reduction))


def describe_fit(
    reduction: Reduction, values: FloatArray, known: PriorInformation | None = None, free: FloatArray | None = None
) -> Solution:
    """Return estimates, whatever they are from, as those of a fit to these equations with the noise that they leave.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    values : (c,)
        Parameters χ.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.
    free : (c, f), optional
        Directions that active constraints leave free.
    """
    noise = compute_noise_levels(reduction, values)
    return Solution(values, noise, build_weighted_factor(reduction, noise, known)[:-1, :-1], known, free)


def compute_noise_levels(reduction: Reduction, values: FloatArray) -> FloatArray:
    """Return the standard deviation of every equation's residual, to weight by.

    Parameters
    ----------
    reduction, values : Reduction, (c,)
        The equations as triangular factors, and parameters χ.

    Returns
    -------
    (n,) array
        Standard deviations in the unit of Y, never zero.
    """
    return floor_noise(compute_residual_noise(reduction, values))


def compute_row_noise(reduction: Reduction, values: FloatArray) -> FloatArray:
    """Return the standard deviation of the residual of all rows that take part in the fit, each counting alike.

    Parameters
    ----------
    reduction, values : Reduction, (c,)
        The equations as triangular factors, and parameters χ.

    Returns
    -------
    (n,) array
        Standard deviations in the unit of Y; zero where the fit is exact.
    """
    return compute_deviation(reduction, compute_fitted_errors(reduction, values).squares)


def floor_noise(sigma: FloatArray) -> FloatArray:
    """Return noise (n,) to weight by, with a lower limit.

    An equation without residual (no torque, no motion) must not get an infinite weight.
    """
    return np.asarray(np.maximum(sigma, 1e-9 * max(float(sigma.max(initial=0.0)), 1e-12)))
