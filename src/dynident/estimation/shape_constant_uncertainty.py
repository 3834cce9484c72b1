"""Joint covariance of shape constants and parameters, from columns linearised about the estimate.

Y = W(θ) χ + ρ is linear in χ, not in θ. About an estimate the columns ∂(W χ)/∂θ are added to W for a change of θ, and
everything that is known of linear estimates holds for both together: the covariance of θ takes that of χ into account,
and the other way round (Seber and Wild 2003, chapter 2). Constants lie in ranges, so that a constant that the data do
not determine does not make everything else uncertain without limit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation.least_squares import (
    build_weighted_factor,
    check_rank,
    compute_correlated_noise,
)
from dynident.estimation.parameter_covariance import CovarianceName, Statistics, statistics
from dynident.estimation.prior_information import PriorInformation, Solution
from dynident.estimation.qr_decomposition import compute_r_factor
from dynident.estimation.triangular_factors import EquationFactors, Reduction

# As in `least_squares`: smallest part of a column that must be independent of the columns before it.
_SINGULAR = 1e-12


@dataclass(frozen=True, eq=False)
class LinearisedSolution:
    """Parameters followed by changes of shape constants: their data, one Gauss-Newton step and their uncertainty.

    Parameters
    ----------
    reduction, solution, statistics : Reduction, Solution, Statistics
        Of parameters and constants together.
    n_own : int
        Number of parameters; the constants follow them.
    """

    reduction: Reduction
    solution: Solution
    statistics: Statistics
    n_own: int

    @property
    def steps(self) -> FloatArray:
        """Change (k,) of each constant that the data ask for."""
        return self.solution.values[self.n_own :]

    @property
    def deviations(self) -> FloatArray:
        """Standard deviations (k,) of the constants."""
        return self.statistics.standard_deviations[self.n_own :]

    @property
    def half_widths(self) -> FloatArray:
        """Half-widths (k,) of the 95 % intervals of the constants."""
        return self.statistics.half_widths()[self.n_own :]

    @property
    def parameter_statistics(self) -> Statistics:
        """Statistics of the parameters alone, the uncertainty of the constants included."""
        b, whole_statistics = self.n_own, self.statistics
        return replace(
            whole_statistics, covariance=whole_statistics.covariance[:b, :b], freedom=whole_statistics.freedom[:b]
        )


def linearise_constants(
    reduction: Reduction, solution: Solution, ranges: FloatArray, kind: CovarianceName
) -> LinearisedSolution:
    """Solve for parameters and shape constants together, one step from an estimate.

    Parameters
    ----------
    reduction : Reduction
        Of [W | ∂(W χ)/∂θ | Y]: the columns of the constants follow those of the parameters.
    solution : Solution
        Of W alone. Its weights, prior knowledge and active constraints are kept.
    ranges : (k,)
        Standard deviations of the constants without any data: those of the ranges that they lie in.
    kind : {"by_time_and_joints", "by_joint", "independent"}
        Which correlations of the residuals are accounted for, see `statistics`.

    Returns
    -------
    LinearisedSolution
        Estimates after the step, with the covariance of parameters and constants together.

    Raises
    ------
    EstimationError
        Where the data, with prior knowledge, do not determine the parameters.
    """
    b, c = len(solution.values), reduction.n_columns
    known, noise = _build_prior_and_noise(reduction, solution, ranges)
    start = np.concatenate([solution.values, np.zeros(c - b)])
    # Solve for the deviation from the estimate within the free directions, so that active constraints stay active.
    free = _build_free_directions(solution, c)
    rows = build_weighted_factor(reduction, noise, known)
    rest = rows[:, c] - rows[:, :c] @ start
    # The free directions mix the columns, so that the product is no longer triangular.
    r = compute_r_factor(np.column_stack([rows[:, :c] @ free, rest]))
    check_rank(r[:-1, :-1], _SINGULAR)
    values = start + free @ np.linalg.solve(r[:-1, :-1], r[:-1, -1])
    stepped = Solution(values, noise, rows[:c, :c], known, None if solution.free is None else free)
    return LinearisedSolution(reduction, stepped, statistics(reduction, stepped, kind), b)


def _build_prior_and_noise(
    reduction: Reduction, solution: Solution, ranges: FloatArray
) -> tuple[PriorInformation, FloatArray]:
    """Return prior knowledge with the ranges of the constants, and the noise (n,) that it is weighed against."""
    b, k = len(solution.values), len(ranges)
    # Each range is an equation change = 0 with the range as its standard deviation: it binds only constants that the
    # data leave open.
    ranges_alone = np.hstack([np.zeros((k, b)), np.diag(1.0 / ranges)])
    before = solution.known
    held = None
    if before is not None and before.held is not None:
        held = np.concatenate([before.held, np.full(k, np.nan)])
    if before is not None and before.has_rows:
        wide = np.hstack([before.factor, np.zeros((len(before.right), k))])
        right = np.concatenate([before.right, np.zeros(k)])
        return PriorInformation(np.vstack([wide, ranges_alone]), right, held), solution.noise
    # Rows count for as much as they are worth as independent samples; how they weigh among each other stays.
    noise, counts = solution.noise, reduction.row_counts
    doubt = compute_correlated_noise(_select_parameters(reduction, b), solution)
    size = float(np.sum(counts * noise**2))
    range_prior = PriorInformation(ranges_alone, np.zeros(k), held)
    return range_prior, noise * float(np.sqrt(np.sum(counts * doubt**2) / size)) if size > 0 else noise


def _select_parameters(reduction: Reduction, b: int) -> Reduction:
    """Return the rows of each block in the columns of the b parameters, as they are weighted; not triangular again."""
    equations = []
    for equation in reduction.equations:
        (own,) = np.nonzero(equation.columns < b)
        factors = equation.factors[:, :, [*own, -1]]
        equations.append(EquationFactors(equation.columns[own], factors, equation.counts))
    return Reduction(b, tuple(equations), reduction.spans)


def _build_free_directions(solution: Solution, c: int) -> FloatArray:
    """Return the free directions (c, f + k): those of the parameters, and all constants."""
    b = len(solution.values)
    if solution.free is None:
        return np.eye(c)
    # Constraints hold parameters alone. Constants may move in any case, with their ranges as prior knowledge.
    f = solution.free.shape[1]
    directions = np.zeros((c, f + c - b))
    directions[:b, :f], directions[b:, f:] = solution.free, np.eye(c - b)
    return directions
