"""The result of an estimator or a strategy."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.estimation import Solution, Statistics
from dynident.identification.standard_parameters import StandardParameters


@dataclass(frozen=True, eq=False)
class Fit:
    """The result of an estimator or a strategy.

    Parameters
    ----------
    solution : Solution
        Estimated base parameters.
    statistics : Statistics
        Their covariance.
    warnings : tuple of str
        How they came about, as far as the user has to know.
    standard : StandardParameters or None
        The standard parameters, where the estimator solves for these.
    """

    solution: Solution
    statistics: Statistics
    warnings: tuple[str, ...] = ()
    standard: StandardParameters | None = None
