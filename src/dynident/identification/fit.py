"""The result of an estimator or a strategy."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.estimation import Solution, Statistics
from dynident.identification.parameters.standard_parameters import StandardParameters


@dataclass(frozen=True, eq=False)
class Fit:
    """Estimates, their uncertainty, and the warnings about how they came about.

    `standard`: the standard parameters, where the estimator solves for these.
    """

    solution: Solution
    statistics: Statistics
    warnings: tuple[str, ...] = ()
    standard: StandardParameters | None = None
