"""Ordinary least squares [12.5]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class Ordinary(Estimator):
    """Ordinary least squares [12.5]."""

    name = "ols"
    label = "ordinary least squares"
    words = "All joints alike [12.5]: strong joints dominate."
    brief = "all joints alike"
    place = 2
    from_reduced = True
    in_steps = True
    weighted = False

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.estimation import ordinary, statistics
        from dynident.identification.fit import Fit

        solution = ordinary(problem.data.equations, problem.known)
        return Fit(solution, statistics(problem.data.equations, solution, problem.covariance))
