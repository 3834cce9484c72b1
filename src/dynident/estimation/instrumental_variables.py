"""Solve W χ = Y with instruments Z from factors, so that noise in W does not bias; holds how weak instruments may be.

Least squares takes W as exact. Positions carry noise and are differentiated twice, so W carries noise too, and what it
shares with the residual biases [12.5]. Instruments Z that correlate with W but not with its noise remove the bias:
χ = (Zᵀ W)⁻¹ Zᵀ Y (Young 1970; Janot, Vandanjon and Gautier 2014 for robots).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from dynident.array_types import FloatArray
from dynident.estimation.least_squares import (
    MOST_ROUNDS,
    EstimationError,
    are_weights_settled,
    build_weighted_factor,
    check_rank,
    check_rows,
    compute_noise_levels,
)
from dynident.estimation.parameter_covariance import (
    CovarianceName,
    Statistics,
    compute_row_freedom,
    estimate_cluster_covariance,
    has_enough_blocks,
)
from dynident.estimation.prior_information import PriorInformation, Solution
from dynident.estimation.qr_decomposition import compute_r_factor
from dynident.estimation.residual_correlation import (
    compute_overstatement,
    compute_scores,
    join_dependent_blocks,
    select_fits,
)
from dynident.estimation.triangular_factors import EquationFactors, Reduction

# Smallest part of a column of Z or W that must be independent of the columns before it.
_SINGULAR = 1e-10
WEAKEST = 0.1
"""Smallest canonical correlation of instruments and observations: below it, some direction is not determined."""


@dataclass(frozen=True, eq=False)
class InstrumentalSolution:
    """Estimates by instrumental variables and their uncertainty.

    Parameters
    ----------
    solution : Solution
        Estimates χ, and the noise that the equations were weighted by.
    statistics : Statistics
        Uncertainty of the estimates.
    strength : float
        Smallest canonical correlation between Z and W, in [0, 1]; 1 where they are the same.
    """

    solution: Solution
    statistics: Statistics
    strength: float


def solve_instrumental(
    both: Reduction, known: PriorInformation | None = None, covariance: CovarianceName = "by_time_and_joints"
) -> InstrumentalSolution:
    """Solve by instrumental variables, each equation weighted by 1 / standard deviation of its residual.

    Parameters
    ----------
    both : Reduction
        Rows [Z | W | Y]: columns 0 … c - 1 are the instruments, c … 2 c - 1 the columns of W that they stand for.
    known : PriorInformation, optional
        Prior knowledge of the parameters, in units of its own standard deviation.
    covariance : {"by_time_and_joints", "by_joint", "independent"}
        Which correlations of the residuals are accounted for, see `statistics`.

    Returns
    -------
    InstrumentalSolution
        Estimates, their uncertainty and the strength of the instruments.

    Raises
    ------
    EstimationError
        Where the instruments do not determine the parameters.
    """
    c = both.n_columns // 2
    observed = both.select_columns(np.arange(c, 2 * c))
    if known is not None and known.held is not None:
        return _solve_beside_held(both, observed, known, covariance)
    # Prior knowledge has no noise in W: it is its own instrument.
    twice = None if known is None else PriorInformation(np.hstack([known.factor, known.factor]), known.right)

    # The weights come from residuals of W χ. Before the first solution there are none, and all equations count alike.
    converged = False
    noise = compute_noise_levels(observed, _solve_weighted(both, np.ones(len(both.equations)), twice).values)
    solved = _solve_weighted(both, noise, twice)
    # Decided once: near the threshold, blocks that are joined could move the fit to where they are not, and back.
    joined = _join_dependent_blocks(both, observed, Solution(solved.values, noise, solved.observed, known))

    def compute_levels(solved: _InstrumentalFactors, noise: FloatArray) -> FloatArray:
        levels = compute_noise_levels(observed, solved.values)
        if known is None:
            return levels
        fit = Solution(solved.values, noise, solved.observed, known)
        return levels * np.sqrt(_compute_overstatements(*joined, fit))

    following = compute_levels(solved, noise)
    for _ in range(MOST_ROUNDS):
        noise = following
        solved = _solve_weighted(both, noise, twice)
        following = compute_levels(solved, noise)
        if converged := are_weights_settled(observed, noise, following):
            break
    solution = Solution(solved.values, noise, solved.observed, known, converged=converged)
    return InstrumentalSolution(
        solution, _compute_statistics(both, observed, solution, solved, covariance), solved.strength
    )


def _solve_beside_held(
    both: Reduction, observed: Reduction, known: PriorInformation, covariance: CovarianceName
) -> InstrumentalSolution:
    """Solve for the parameters that are not held, with the torque of the others on the right-hand side."""
    where = ~known.is_held
    held = known.restore_held(np.zeros(int(where.sum())))
    moved = both.move_columns(np.concatenate([np.zeros(len(held)), held]), np.concatenate([where, where]))
    rows = known.remove_held()
    alone = solve_instrumental(moved, rows if rows.has_rows else None, covariance)
    inner, c = alone.statistics, len(held)
    spread, freedom = np.zeros((c, c)), np.full(c, np.inf)
    spread[np.ix_(where, where)], freedom[where] = inner.covariance, inner.freedom
    noise = alone.solution.noise
    factor = build_weighted_factor(observed, noise, known)[:-1, :-1]
    values = known.restore_held(alone.solution.values)
    return InstrumentalSolution(
        Solution(values, noise, factor, known, np.eye(c)[:, where], alone.solution.converged),
        Statistics(spread, inner.effective_rows, inner.noise, freedom),
        alone.strength,
    )


@dataclass(frozen=True, eq=False)
class _InstrumentalFactors:
    """χ (c,), the factors of the weighted Z and W (c, c), and W projected on Z: Q_zᵀ W (c, c)."""

    values: FloatArray
    instruments: FloatArray
    observed: FloatArray
    projected: FloatArray
    strength: float


def _solve_weighted(both: Reduction, noise: FloatArray, twice: PriorInformation | None) -> _InstrumentalFactors:
    c = both.n_columns // 2
    check_rows(both.n_rows, c, twice)
    r = build_weighted_factor(both, noise, twice)
    # One QR of [Z | W | Y] gives everything: its first block rows are R_z, Q_zᵀ W and Q_zᵀ Y.
    instruments, projected, right = r[:c, :c], r[:c, c : 2 * c], r[:c, 2 * c]
    # Two blocks of rows: what W has in common with Z, and what it has besides, which is noise or not simulated.
    observed = compute_r_factor(r[: 2 * c, c : 2 * c])
    check_rank(instruments, _SINGULAR, " of the simulated motion")
    check_rank(observed, _SINGULAR, " of the measured motion")
    # Q_zᵀ Q_w: its singular values are the canonical correlations.
    common = solve_triangular(observed, projected.T, trans="T").T
    strength = float(np.linalg.svd(common, compute_uv=False)[-1])
    if strength < WEAKEST:
        raise EstimationError(
            f"the correlation of the simulated with the measured motion is only {strength:.2g} in the weakest "
            "direction: its rows are too weak as instruments for these parameters. Use wls, or data with more "
            "motion",
            pointer="/estimator",
            title="Weak instruments",
        )
    values = solve_triangular(observed, np.linalg.solve(common, right))
    return _InstrumentalFactors(values, instruments, observed, projected, strength)


def _compute_overstatements(both: Reduction, observed: Reduction, solution: Solution) -> FloatArray:
    """Return by how much the rows of every equation overstate the information in them (n,), in independent blocks."""
    inflation = []
    for whole, equation, fit in zip(both.equations, observed.equations, select_fits(observed, solution), strict=True):
        instruments, w, rests = _split_instruments(whole, solution.values)
        inflation.append(compute_overstatement(instruments, rests, float(equation.counts.sum()), fit, w))
    return np.array(inflation)


def _join_dependent_blocks(both: Reduction, observed: Reduction, solution: Solution) -> tuple[Reduction, Reduction]:
    """Return the data in blocks that are independent of their neighbours, with instruments and without."""
    observed = join_dependent_blocks(observed, solution)
    while both.n_blocks > observed.n_blocks:
        both = both.merge_block_pairs()
    return both, observed


def _compute_statistics(
    both: Reduction, observed: Reduction, solution: Solution, solved: _InstrumentalFactors, kind: CovarianceName
) -> Statistics:
    """Return (ZᵀW)⁻¹ Zᵀ cov(ρ) Z (WᵀZ)⁻¹, with correlated residuals treated as in `statistics`."""
    noise = compute_noise_levels(observed, solution.values)
    both, observed = _join_dependent_blocks(both, observed, solution)
    overstated = _compute_overstatements(both, observed, solution)
    worth = both.row_counts / overstated
    if has_enough_blocks(observed, kind):
        # Of the instruments those combinations whose ZᵀW is WᵀW; their leverage is that of W, which they go with.
        turned = solve_triangular(solved.instruments, np.linalg.solve(solved.projected.T, solved.observed.T))
        scores = []
        for equation, sigma in zip(both.equations, solution.noise, strict=True):
            instruments, _, rests = _split_instruments(equation, solution.values)
            where = equation.columns[: instruments.shape[2]]
            scores.append(compute_scores(instruments, rests) @ (turned[where] / sigma**2))
        spread = estimate_cluster_covariance(observed, solution, kind, scores, is_ordered=True)
        return Statistics(spread.covariance, worth, noise, spread.freedom)
    c = observed.n_columns
    counted = np.ones(len(overstated)) if kind == "independent" else overstated
    meat = np.zeros((c, c))
    for j, equation in enumerate(both.equations):
        k = len(equation.columns) // 2
        z = equation.whole_factor[:, :k]
        where = equation.columns[:k]
        meat[np.ix_(where, where)] += (noise[j] ** 2 * counted[j] / solution.noise[j] ** 4) * (z.T @ z)
    if solution.known is not None:
        meat += solution.known.factor.T @ solution.known.factor
    # Meat in the coordinates of Q_z, R_z⁻ᵀ M R_z⁻¹: ZᵀW, which may be ill-conditioned, is never formed.
    whitened = solve_triangular(solved.instruments, meat, trans="T")
    whitened = solve_triangular(solved.instruments, whitened.T, trans="T")
    inverse = np.linalg.inv(solved.projected)
    covariance = inverse @ whitened @ inverse.T
    freedom = compute_row_freedom(both.row_counts / counted, c)
    return Statistics(0.5 * (covariance + covariance.T), worth, noise, freedom)


def _split_instruments(equation: EquationFactors, values: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return Z (s, m, k), W (s, m, k) and the residuals (s, m) of every block of rows [Z | W | Y]."""
    k = len(equation.columns) // 2
    instruments, w, y = np.split(equation.factors, [k, 2 * k], axis=2)
    return instruments, w, y[:, :, 0] - w @ values[equation.columns[:k]]
