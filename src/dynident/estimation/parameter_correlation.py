"""Pairs of strongly correlated estimates (above 0.9), directions that data hardly determine; condition numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.estimation.least_squares import (
    build_weighted_factor,
)
from dynident.estimation.parameter_covariance import Statistics, compute_correlations
from dynident.estimation.prior_information import Solution
from dynident.estimation.triangular_factors import Reduction

STRONG_CORRELATION = 0.9
"""Correlation of two estimates above which they are determined mostly together."""

POORLY_DETERMINED, NOT_DETERMINED = 50.0, 1000.0
"""How many times less than the best direction one is seen to be called hardly, or not, determined."""

# Share of the largest contribution below which a parameter does not belong to a direction.
_SHOWN = 0.25


@dataclass(frozen=True)
class CorrelatedPair:
    """Two parameters whose estimates correlate.

    Parameters
    ----------
    first, second : int
        Numbers of the parameters.
    correlation : float
        Correlation of their estimates, in [-1, 1].
    """

    first: int
    second: int
    correlation: float


@dataclass(frozen=True)
class WeakDirection:
    """A combination of parameters that the data hardly determine.

    Parameters
    ----------
    parts : tuple of (number, factor)
        The parameters in it, the one with the largest factor, 1, first.
    ratio : float
        How many times less than the best direction the torque shows it, with columns of W scaled to equal size.
    deviation : float
        Standard deviation of the combination.
    """

    parts: tuple[tuple[int, float], ...]
    ratio: float
    deviation: float


@dataclass(frozen=True, eq=False)
class Collinearity:
    """What the data determine only together, or hardly.

    Parameters
    ----------
    correlation : (c, c)
        Correlation of all estimates.
    pairs : tuple of CorrelatedPair
        Closely correlated parameters, worst first.
    directions : tuple of WeakDirection
        Poorly determined combinations, worst first.
    """

    correlation: FloatArray
    pairs: tuple[CorrelatedPair, ...]
    directions: tuple[WeakDirection, ...]


def find_collinearity(solution: Solution, uncertainty: Statistics, most: int = 10) -> Collinearity:
    """Find parameters that the data determine only together.

    Parameters
    ----------
    solution : Solution
        Estimates, with the factor of the weighted W that they were solved from.
    uncertainty : Statistics
        Covariance of the same estimates.
    most : int
        Largest number of pairs and of directions.

    Returns
    -------
    Collinearity
        Correlations, close pairs and poorly determined directions.
    """
    correlation = compute_correlations(uncertainty.covariance)
    # A parameter that is fixed has no correlation with anything.
    fixed = np.diag(uncertainty.covariance) <= 0
    correlation[fixed] = correlation[:, fixed] = 0.0
    np.fill_diagonal(correlation, 1.0)
    return Collinearity(
        correlation, _find_correlated_pairs(correlation, most), _find_weak_directions(solution, uncertainty, most)
    )


def _find_correlated_pairs(correlation: FloatArray, most: int) -> tuple[CorrelatedPair, ...]:
    first, second = np.nonzero(np.triu(np.abs(correlation) >= STRONG_CORRELATION, 1))
    sizes = correlation[first, second]
    order = np.argsort(-np.abs(sizes), kind="stable")[:most]
    return tuple(CorrelatedPair(int(first[k]), int(second[k]), float(sizes[k])) for k in order)


def _find_weak_directions(solution: Solution, uncertainty: Statistics, most: int) -> tuple[WeakDirection, ...]:
    # A parameter that is held takes no part in a direction that is poorly determined.
    where = np.flatnonzero(~solution.is_held)
    scales = solution.scales[where]
    if len(scales) == 0 or np.any(scales <= 0):
        return ()
    # A singular value is the norm of the torque that a unit step along its direction causes. Scaled columns make the
    # ratio independent of the parameters' units.
    _, singular, vt = np.linalg.svd(solution.factor[:, where] / scales)
    weak_directions: list[WeakDirection] = []
    for size, direction in zip(singular[::-1], vt[::-1], strict=True):
        ratio = float(singular[0] / size) if size > 0 else float("inf")
        if ratio < POORLY_DETERMINED or len(weak_directions) == most:
            break
        members = np.flatnonzero(np.abs(direction) >= _SHOWN * np.abs(direction).max())
        # The combination whose estimate is bad: v in columns of equal size is v times their sizes in parameters.
        weights = direction * scales
        largest = members[np.argmax(np.abs(weights[members]))]
        weights = weights / weights[largest]
        order = members[np.argsort(-np.abs(weights[members]), kind="stable")]
        parts = tuple((int(where[k]), float(weights[k])) for k in order)
        weak_directions.append(
            WeakDirection(
                parts, ratio, float(np.sqrt(max(weights @ uncertainty.covariance[np.ix_(where, where)] @ weights, 0.0)))
            )
        )
    return tuple(weak_directions)


def compute_condition_number(reduction: Reduction) -> float:
    """Return cond(W), [12.12], of the unweighted W without prior knowledge.

    Parameters
    ----------
    reduction : Reduction
        The equations as triangular factors, by blocks of time.

    Returns
    -------
    float
        Ratio of the largest to the smallest singular value; infinite where W is singular.
    """
    return _compute_condition(
        build_weighted_factor(reduction.equally_weighted, np.ones(len(reduction.equations)))[:-1, :-1]
    )


def compute_equilibrated_condition_number(reduction: Reduction, noise: FloatArray) -> float:
    """Return cond(W) with columns scaled to equal size, so that units of parameters do not count.

    Parameters
    ----------
    reduction, noise : Reduction, (n,)
        The equations as triangular factors, and the standard deviation of each one's residual, by which it is divided.

    Returns
    -------
    float
        Ratio of the largest to the smallest singular value; infinite where W is singular.
    """
    factor = build_weighted_factor(reduction, noise)[:-1, :-1]
    scales = np.linalg.norm(factor, axis=0)
    return _compute_condition(factor / np.where(scales > 0, scales, 1.0))


def _compute_condition(factor: FloatArray) -> float:
    singular = np.linalg.svd(factor, compute_uv=False)
    return float(singular[0] / singular[-1]) if singular[-1] > 0 else float("inf")
