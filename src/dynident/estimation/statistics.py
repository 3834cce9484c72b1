"""How sure the estimates are, [12.6]-[12.10], for residuals that are correlated in time.

[12.6] assumes independent residuals. Rows that passed a low-pass filter are not, and model errors even less: counting
them all would promise standard deviations several times too small. The correlation is measured here from the sums of
Wᵀρ over stretches of time: of independent residuals their squares would have a known size, and what they have more is
the factor by which the number of rows overstates the information (a cluster-robust variance, Liang and Zeger 1986,
pooled over the parameters of an equation).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtrit

from dynident.estimation.correlation import correlation_factors
from dynident.estimation.factors import Reduction
from dynident.estimation.information import deviations_of
from dynident.estimation.least_squares import Solution, residual_noise
from dynident.estimation.triangles import FloatArray

NORMAL_95 = 1.96
"""Standard deviations on either side that hold a normally distributed error with a probability of 95 %."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Uncertainty of a solution.

    `covariance` (c, c) of the estimation error [12.8]; `effective_rows` (n,): the number of independent samples that
    each equation's rows are worth; `noise` (n,): standard deviation of each equation's residual [12.7].
    """

    covariance: FloatArray
    effective_rows: FloatArray
    noise: FloatArray

    @property
    def standard_deviations(self) -> FloatArray:
        """(c,): [12.9]."""
        return deviations_of(self.covariance)

    @property
    def freedom(self) -> float:
        """Degrees of freedom: independent samples less parameters, at least 1."""
        return max(float(np.sum(self.effective_rows)) - len(self.covariance), 1.0)

    def half_widths(self, level: float = 0.95) -> FloatArray:
        """(c,): half-widths of the intervals that hold the true value with a probability of `level` (Student's t)."""
        return np.asarray(stdtrit(self.freedom, 0.5 + 0.5 * level) * self.standard_deviations)

    def relative_standard_deviations(self, values: FloatArray) -> FloatArray:
        """(c,): [12.10] as a fraction; infinite for a parameter whose estimate is zero."""
        size = np.abs(values)
        relative = np.full(len(size), np.inf)
        np.divide(self.standard_deviations, size, out=relative, where=size > 0)
        return relative


def statistics(reduction: Reduction, solution: Solution) -> Statistics:
    """Covariance of the estimates with the correlation of the residuals accounted for."""
    inflation = correlation_factors(reduction, solution.values)
    bread = solution.normal_inverse
    c = reduction.n_columns
    meat = np.zeros((c, c))
    noise = residual_noise(reduction, solution.values)
    weights = noise**2 * inflation / solution.noise**4
    for equation, weight in zip(reduction.equations, weights, strict=True):
        w = equation.joined[:, :-1]
        meat[np.ix_(equation.columns, equation.columns)] += weight * (w.T @ w)
    if solution.known is not None:
        meat += solution.known.factor.T @ solution.known.factor
    covariance = bread @ meat @ bread
    return Statistics(0.5 * (covariance + covariance.T), reduction.row_counts / inflation, noise)


def correlations(covariance: FloatArray) -> FloatArray:
    """(c, c): correlation of the estimates."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    return np.asarray(covariance / np.outer(deviation, deviation))
