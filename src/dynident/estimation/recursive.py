"""Covariance of a recursive estimate, from the equations of the parameters that its samples gave.

A filter's own covariance takes its noise as white and known. Here the correlation of its residuals is
measured from sums over blocks of time, as `statistics` does for residuals of least squares. All of these equations
contain all parameters, most of them with tiny coefficients. Sums are therefore taken in units of the final uncertainty,
so that directions that an equation hardly contains do not dominate its score.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from dynident.arrays import FloatArray
from dynident.estimation.factors import Reduction
from dynident.estimation.information import PriorInformation
from dynident.estimation.least_squares import build_weighted_factor
from dynident.estimation.statistics import Statistics, compute_row_freedom


def compute_recursive_statistics(rows: Reduction, values: FloatArray, start: PriorInformation) -> Statistics:
    """Return the statistics of parameters χ (c,) that are the least-squares solution of `rows` and `start` together.

    Parameters
    ----------
    rows : Reduction
        Equations whose noise is of size one, if it is as assumed.
    values : (c,)
        Parameters χ.
    start : Information
        Prior knowledge, taken at its word.

    Returns
    -------
    Statistics

    Notes
    -----
    With B the inverse of all information and A_s, g_s = W_sᵀρ_s that of block s of one equation and its score,
    independent residuals of variance σ² have Σ g_sᵀ B g_s = σ² Σ [tr(B A_s) - tr((B A_s)²)]: the ratio is the variance
    that the equation counts with, at least that of its residual.
    """
    factor = build_weighted_factor(rows, np.ones(len(rows.equations)), start)[:-1, :-1]
    inverse = solve_triangular(factor, np.eye(rows.n_columns))
    known = start.factor @ inverse
    meat = known.T @ known
    effective, noise = np.zeros(len(rows.equations)), np.zeros(len(rows.equations))
    for j, equation in enumerate(rows.equations):
        w = equation.factors[:, :, :-1]
        rests = equation.factors[:, :, -1] - w @ values[equation.columns]
        w = w @ inverse[equation.columns]
        information = w.transpose(0, 2, 1) @ w
        scores = (rests[:, None, :] @ w)[:, 0]
        count = float(equation.counts.sum())
        variance = float(np.sum(rests * rests)) / max(count, 1.0)
        expected = float(np.trace(information, axis1=1, axis2=2).sum() - np.sum(information * information))
        # Correlated residuals make the score larger than independent ones would. Smaller is chance and is not used.
        counted = max(variance, float(np.sum(scores * scores)) / expected if expected > 0 else 0.0)
        meat += counted * information.sum(axis=0)
        effective[j] = count * variance / counted if counted > 0 else count
        noise[j] = np.sqrt(variance)
    covariance = inverse @ meat @ inverse.T
    return Statistics(
        0.5 * (covariance + covariance.T), effective, noise, compute_row_freedom(effective, rows.n_columns)
    )
