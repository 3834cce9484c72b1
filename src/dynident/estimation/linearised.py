"""How sure constants are that the columns of W depend on: the equations made linear in them about the estimate.

Y = W(θ) χ + ρ is linear in χ, not in θ. About an estimate the columns ∂(W χ)/∂θ stand beside W for a change of θ, and
everything that is known of linear estimates holds for both together: the covariance of θ has that of χ accounted for,
and the other way round (Seber and Wild 2003, chapter 2). Constants lie in ranges, which keeps one that the data do not
tell of from making everything about it uncertain without end.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.estimation.factors import Reduction
from dynident.estimation.information import Information
from dynident.estimation.least_squares import Solution, check_rank, doubtful_noise, weighted_factor
from dynident.estimation.statistics import CovarianceName, Statistics, statistics
from dynident.estimation.triangles import triangular

_SINGULAR = 1e-12


@dataclass(frozen=True, eq=False)
class Linearised:
    """Parameters and, behind them, changes of constants: their data, one step of theirs, and how sure both are.

    `n_own`: how many parameters there are.
    """

    reduction: Reduction
    solution: Solution
    statistics: Statistics
    n_own: int

    @property
    def steps(self) -> FloatArray:
        """(k,): how far the data would have each constant moved."""
        return self.solution.values[self.n_own :]

    @property
    def deviations(self) -> FloatArray:
        """(k,): standard deviations of the constants."""
        return self.statistics.standard_deviations[self.n_own :]

    @property
    def half_widths(self) -> FloatArray:
        """(k,): half-widths of their 95 % intervals."""
        return self.statistics.half_widths()[self.n_own :]

    @property
    def of_parameters(self) -> Statistics:
        """How sure the parameters are with the constants uncertain, too."""
        b, found = self.n_own, self.statistics
        return replace(found, covariance=found.covariance[:b, :b], freedom=found.freedom[:b])


def linearised(reduction: Reduction, solution: Solution, ranges: FloatArray, kind: CovarianceName) -> Linearised:
    """Parameters and constants together, one step from an estimate.

    Parameters
    ----------
    reduction : of [W | ∂(W χ)/∂θ | Y]
        The columns of the constants behind those of the parameters.
    solution : of W alone
        Its weights, what was known beside the data and what constraints hold are kept.
    ranges : (k,)
        Standard deviations that the constants have without any data: those of the ranges that they lie in.
    kind : what of the residuals is taken to be correlated

    Raises
    ------
    EstimationError
        Where this data, and what was known beside it, does not determine the parameters.
    """
    b, c = len(solution.values), reduction.n_columns
    known, noise = _known(reduction, solution, ranges)
    start = np.concatenate([solution.values, np.zeros(c - b)])
    free = _directions(solution, c)
    rows = weighted_factor(reduction, noise, known)
    rest = rows[:, c] - rows[:, :c] @ start
    r = triangular(np.column_stack([rows[:, :c] @ free, rest]))
    check_rank(r[:-1, :-1], _SINGULAR)
    values = start + free @ np.linalg.solve(r[:-1, :-1], r[:-1, -1])
    stepped = Solution(values, noise, rows[:c, :c], known, None if solution.free is None else free)
    return Linearised(reduction, stepped, statistics(reduction, stepped, kind), b)


def _known(reduction: Reduction, solution: Solution, ranges: FloatArray) -> tuple[Information, FloatArray]:
    """What is known with the ranges of the constants, and the noise (n,) of rows that it is weighed against."""
    b, k = len(solution.values), len(ranges)
    told = Information(np.hstack([np.zeros((k, b)), np.diag(1.0 / ranges)]), np.zeros(k))
    before = solution.known
    if before is not None:
        wide = np.hstack([before.factor, np.zeros((len(before.right), k))])
        return Information(wide, before.right).and_also(told), solution.noise
    # Rows count for as much as they are worth as independent samples; how they weigh among each other stays.
    noise, counts = solution.noise, reduction.row_counts
    doubt = doubtful_noise(reduction.select(np.arange(b)), solution.values)
    size = float(np.sum(counts * noise**2))
    return told, noise * float(np.sqrt(np.sum(counts * doubt**2) / size)) if size > 0 else noise


def _directions(solution: Solution, c: int) -> FloatArray:
    """(c, f + k): what is free of the parameters, and all constants."""
    b = len(solution.values)
    if solution.free is None:
        return np.eye(c)
    f = solution.free.shape[1]
    found = np.zeros((c, f + c - b))
    found[:b, :f], found[b:, f:] = solution.free, np.eye(c - b)
    return found
