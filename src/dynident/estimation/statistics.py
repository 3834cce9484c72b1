"""How sure the estimates are, [12.6]-[12.10], for residuals that are correlated in time and between equations.

[12.6] assumes independent residuals. Rows that passed a low-pass filter are not, and model errors even less: counting
them all would promise standard deviations several times too small. Three covariances are to be had, as of regressions
with clustered data elsewhere:

by_time_and_joints
    Stretches of time are independent, nothing within them is, across all equations (`clusters`).
by_joint
    Equations are independent, too. The correlation within an equation is measured from the sums of Wᵀρ over stretches
    of time: of independent residuals their squares would have a known size, and what they have more is the factor by
    which the number of rows overstates the information (Liang and Zeger 1986, pooled over the parameters).
independent
    [12.6] as it stands: every row counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import stdtrit

from dynident.arrays import FloatArray
from dynident.estimation.clusters import FEWEST_CLUSTERS, occupied, spread_over_stretches
from dynident.estimation.correlation import correlation_factors
from dynident.estimation.factors import Reduction
from dynident.estimation.information import deviations_of
from dynident.estimation.least_squares import Solution, residual_noise

CovarianceName = Literal["by_time_and_joints", "by_joint", "independent"]

NORMAL_95 = 1.96
"""Standard deviations on either side that hold a normally distributed error with a probability of 95 %."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Uncertainty of a solution.

    `covariance` (c, c) of the estimation error [12.8]; `effective_rows` (n,): the number of independent samples that
    each equation's rows are worth; `noise` (n,): standard deviation of each equation's residual [12.7]; `freedom` (c,):
    degrees of freedom that the variance of each estimate is known with.
    """

    covariance: FloatArray
    effective_rows: FloatArray
    noise: FloatArray
    freedom: FloatArray

    @property
    def standard_deviations(self) -> FloatArray:
        """(c,): [12.9]."""
        return deviations_of(self.covariance)

    @property
    def usual_freedom(self) -> float:
        """Degrees of freedom of what depends on many estimates: the median of theirs."""
        return float(np.median(self.freedom)) if len(self.freedom) else 1.0

    def half_widths(self, level: float = 0.95) -> FloatArray:
        """(c,): half-widths of the intervals that hold the true value with a probability of `level` (Student's t)."""
        return np.asarray(stdtrit(self.freedom, 0.5 + 0.5 * level) * self.standard_deviations)

    def relative_standard_deviations(self, values: FloatArray) -> FloatArray:
        """(c,): [12.10] as a fraction; infinite for a parameter whose estimate is zero."""
        size = np.abs(values)
        relative = np.full(len(size), np.inf)
        np.divide(self.standard_deviations, size, out=relative, where=size > 0)
        return relative


def statistics(reduction: Reduction, solution: Solution, kind: CovarianceName = "by_time_and_joints") -> Statistics:
    """Covariance of the estimates, with what `kind` says is correlated accounted for.

    Where there are fewer than five stretches of time nothing tells how the rows of different equations go together,
    and by_time_and_joints is by_joint.
    """
    inflation = correlation_factors(reduction, solution.values)
    noise = residual_noise(reduction, solution.values)
    worth = reduction.row_counts / inflation
    if kind == "by_time_and_joints" and occupied(reduction).sum() >= FEWEST_CLUSTERS:
        spread = spread_over_stretches(reduction, solution)
        return Statistics(spread.covariance, worth, noise, spread.freedom)
    counted = np.ones(len(inflation)) if kind == "independent" else inflation
    bread = solution.normal_inverse
    c = reduction.n_columns
    meat = np.zeros((c, c))
    weights = noise**2 * counted / solution.noise**4
    for equation, weight in zip(reduction.equations, weights, strict=True):
        w = equation.joined[:, :-1]
        meat[np.ix_(equation.columns, equation.columns)] += weight * (w.T @ w)
    if solution.known is not None:
        meat += solution.known.factor.T @ solution.known.factor
    covariance = bread @ meat @ bread
    freedom = freedom_of_rows(reduction.row_counts / counted, c)
    return Statistics(0.5 * (covariance + covariance.T), worth, noise, freedom)


def freedom_of_rows(independent: FloatArray, n_columns: int) -> FloatArray:
    """(c,): degrees of freedom where so many rows (n,) of every equation are independent: what the fit leaves."""
    return np.full(n_columns, max(float(independent.sum()) - n_columns, 1.0))


def correlations(covariance: FloatArray) -> FloatArray:
    """(c, c): correlation of the estimates."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    return np.asarray(covariance / np.outer(deviation, deviation))
