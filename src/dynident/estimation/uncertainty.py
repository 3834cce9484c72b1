"""Uncertainty of the estimates, [12.6]-[12.10], for residuals that are correlated in time and between equations.

[12.6] assumes independent residuals. Rows that passed a low-pass filter are not, and model errors even less: counting
them all would promise standard deviations several times too small. There are three covariances, as in regression
with clustered data elsewhere:

by_time_and_joints
    Blocks of time are independent, nothing within them is, across all equations (`cluster_robust`).
by_joint
    Equations are independent, too. The correlation within an equation is measured from the sums of Wᵀρ over blocks
    of time. The squares of these sums have a known size for independent residuals; the excess is the factor by
    which the number of rows overstates the information (Liang and Zeger 1986, pooled over the parameters).
independent
    [12.6] as it stands: every row counts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from dynident.array_types import FloatArray
from dynident.estimation.cluster_robust import FEWEST_CLUSTERS, estimate_cluster_covariance, find_occupied_blocks
from dynident.estimation.factors import Reduction
from dynident.estimation.least_squares import (
    Solution,
    build_weighted_factor,
    compute_correlated_noise,
    compute_residual_noise,
)
from dynident.estimation.prior_information import extract_deviations
from dynident.estimation.residual_correlation import compute_correlation_factors

# Singular values below this share of the largest count as zero; a parameter with more than so much of an undetermined
# direction in it counts as undetermined.
_NULL, _LOOSE = 1e-9, 1e-5
# More than so many times as sure as by the data alone: three quarters of what is known come from elsewhere.
_OWED = 2.0


def compute_standard_deviations(rows: FloatArray, held: FloatArray | None = None) -> FloatArray:
    """Return the standard deviations (c,) of parameters that rows determine.

    Parameters
    ----------
    rows : (r, c)
        Rows of W in units of their noise.
    held : (h, c), optional
        Directions that constraints hold, taken as certain.

    Returns
    -------
    (c,) array
        Infinite where a parameter is left undetermined.
    """
    # Columns of unit length: the threshold for singular values must not depend on the parameters' units.
    size = np.linalg.norm(rows, axis=0)
    size = np.where(size > 0, size, 1.0)
    scaled = rows / size
    moving = np.eye(rows.shape[1]) if held is None or not len(held) else compute_null_space(held / size)
    _, singular, vt = np.linalg.svd(scaled @ moving, full_matrices=True)
    enough = singular > _NULL * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)
    count = int(np.count_nonzero(enough))
    determined = moving @ (vt[:count].T / singular[:count])
    # A parameter counts as undetermined as soon as an undetermined direction contains it by more than rounding.
    loose = np.abs(moving @ vt[count:].T).max(axis=1, initial=0.0) > _LOOSE
    return np.asarray(np.where(loose, np.inf, np.linalg.norm(determined, axis=1) / size))


def compute_null_space(rows: FloatArray, size: float = float(np.finfo(float).tiny)) -> FloatArray:
    """Return orthonormal directions that rows map to zero.

    A singular value counts as zero when it is small compared to the largest one, or to `size` where that is larger.

    Parameters
    ----------
    rows : (h, c)
        The rows.
    size : float
        Lower bound of the scale that singular values are compared to.

    Returns
    -------
    (c, k) array
        One direction a column.
    """
    _, singular, vt = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.count_nonzero(singular > _NULL * max(float(singular.max(initial=0.0)), size)))
    return np.asarray(vt[rank:].T)


def find_prior_dominated(reduction: Reduction, solution: Solution) -> NDArray[np.bool_]:
    """Return which parameters rest on prior knowledge rather than on the data.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.
    solution : Solution
        The estimate from these data.

    Returns
    -------
    (c,) array of bool
        True where the data alone would leave more than twice the standard deviation.
    """
    if solution.known is None:
        return np.zeros(len(solution.values), dtype=bool)
    noise = compute_correlated_noise(reduction, solution.values)
    c = reduction.n_columns
    # The noise is corrected for correlated rows, as it is where prior knowledge is weighed against the data.
    alone = compute_standard_deviations(build_weighted_factor(reduction, noise)[:c, :c])
    together = compute_standard_deviations(build_weighted_factor(reduction, noise, solution.known)[:c, :c])
    return np.asarray(alone > _OWED * together)


CovarianceName = Literal["by_time_and_joints", "by_joint", "independent"]

NORMAL_95 = 1.96
"""Standard deviations on either side that hold a normally distributed error with a probability of 95 %."""


@dataclass(frozen=True, eq=False)
class Statistics:
    """Uncertainty of a solution.

    Parameters
    ----------
    covariance : (c, c)
        Of the estimation error, [12.8].
    effective_rows : (n,)
        Number of independent samples that each equation's rows are worth.
    noise : (n,)
        Standard deviation of each equation's residual, [12.7].
    freedom : (c,)
        Degrees of freedom with which the variance of each estimate is known.
    """

    covariance: FloatArray
    effective_rows: FloatArray
    noise: FloatArray
    freedom: FloatArray

    @property
    def standard_deviations(self) -> FloatArray:
        """Standard deviations (c,) of the estimates, [12.9]."""
        return extract_deviations(self.covariance)

    @property
    def median_freedom(self) -> float:
        """Median of the degrees of freedom, for quantities that depend on many estimates."""
        return float(np.median(self.freedom)) if len(self.freedom) else 1.0

    def half_widths(self, level: float = 0.95) -> FloatArray:
        """Return the half-widths (c,) of the intervals that hold the true value with this probability (Student's t)."""
        return np.asarray(stdtrit(self.freedom, 0.5 + 0.5 * level) * self.standard_deviations)

    def relative_standard_deviations(self, values: FloatArray) -> FloatArray:
        """Return the standard deviations relative to the estimates, [12.10].

        Parameters
        ----------
        values : (c,)
            The estimates.

        Returns
        -------
        (c,) array
            Fractions; infinite for a parameter whose estimate is zero.
        """
        size = np.abs(values)
        relative = np.full(len(size), np.inf)
        np.divide(self.standard_deviations, size, out=relative, where=size > 0)
        return relative


def statistics(reduction: Reduction, solution: Solution, kind: CovarianceName = "by_time_and_joints") -> Statistics:
    """Return the covariance of the estimates with the correlations that `kind` names accounted for.

    With fewer than five blocks of time nothing tells how the rows of different equations correlate, and
    by_time_and_joints is by_joint.

    Parameters
    ----------
    reduction, solution : Reduction, Solution
        The data and the estimate from it.
    kind : {"by_time_and_joints", "by_joint", "independent"}
        Which correlations of the residuals are accounted for: within blocks of time across all equations, within each
        equation, or none.

    Returns
    -------
    Statistics
        Covariance, effective numbers of rows, noise and degrees of freedom.
    """
    inflation = compute_correlation_factors(reduction, solution.values)
    noise = compute_residual_noise(reduction, solution.values)
    worth = reduction.row_counts / inflation
    if kind == "by_time_and_joints" and find_occupied_blocks(reduction).sum() >= FEWEST_CLUSTERS:
        spread = estimate_cluster_covariance(reduction, solution)
        return Statistics(spread.covariance, worth, noise, spread.freedom)
    # "independent" takes every row at its word; "by_joint" inflates each equation's variance by its own correlation.
    counted = np.ones(len(inflation)) if kind == "independent" else inflation
    # The sandwich estimator: B (Σ σⱼ² inflationⱼ WⱼᵀWⱼ) B. It is [12.8] where the weights are the true noise.
    bread = solution.normal_inverse
    c = reduction.n_columns
    meat = np.zeros((c, c))
    weights = noise**2 * counted / solution.noise**4
    for equation, weight in zip(reduction.equations, weights, strict=True):
        w = equation.joint_factor[:, :-1]
        meat[np.ix_(equation.columns, equation.columns)] += weight * (w.T @ w)
    if solution.known is not None:
        # Rows of prior knowledge are in units of their own deviation, so their variance is one.
        meat += solution.known.factor.T @ solution.known.factor
    covariance = bread @ meat @ bread
    freedom = compute_row_freedom(reduction.row_counts / counted, c)
    # Rounding leaves the product slightly asymmetric.
    return Statistics(0.5 * (covariance + covariance.T), worth, noise, freedom)


def compute_row_freedom(independent: FloatArray, n_columns: int) -> FloatArray:
    """Return the degrees of freedom that a fit leaves of independent rows, the same for all parameters.

    Parameters
    ----------
    independent : (n,)
        Number of independent rows of every equation.
    n_columns : int
        Number of parameters c.

    Returns
    -------
    (c,) array
        The same number for every parameter, at least 1.
    """
    return np.full(n_columns, max(float(independent.sum()) - n_columns, 1.0))


def compute_correlations(covariance: FloatArray) -> FloatArray:
    """Return the correlation matrix (c, c) of the estimates."""
    deviation = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    return np.asarray(covariance / np.outer(deviation, deviation))
