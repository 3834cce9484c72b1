"""Weighted least squares: each joint by the noise of its residual, rows at reversals by a noise of their own."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class Weighted(Estimator):
    """Weighted least squares."""

    name = "wls"
    label = "weighted least squares"
    words = "Each joint weighted by its noise. Also where no robot has what comes out."
    brief = "each joint weighted by its noise"
    place = 1
    from_reduced = True
    weighs_turns = True
    in_steps = True
    priors = ("description",)

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.estimation import statistics, weighted
        from dynident.identification.fit import Fit

        solution = weighted(problem.data.equations, problem.known)
        return Fit(solution, statistics(problem.data.equations, solution, problem.covariance))
