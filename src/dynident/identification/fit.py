"""What an estimator and a strategy give."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.estimation import Solution, Statistics
from dynident.identification.parameters.standard import StandardParameters


@dataclass(frozen=True, eq=False)
class Fit:
    """Estimates, how sure they are, and what the user must be told about how they came about.

    `standard`: the standard parameters, where the estimator solves for these.
    """

    solution: Solution
    statistics: Statistics
    warnings: tuple[str, ...] = ()
    standard: StandardParameters | None = None
