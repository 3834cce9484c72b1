"""Instrumental variables from a simulated robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class InstrumentalVariables(Estimator):
    """Instrumental variables from a simulated robot."""

    name = "iv"
    label = "instrumental variables"
    words = "Unbiased where noisy encoders pull least squares off; simulates the robot a few times."
    brief = "instruments from a simulation"
    place = 5
    simulates = True
    tells_convergence = True

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.simulated_regressors import estimate_by_instrumental_variables

        return estimate_by_instrumental_variables(problem)
