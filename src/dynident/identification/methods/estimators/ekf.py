"""An extended Kalman filter with the parameters as states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class Kalman(Estimator):
    """An extended Kalman filter with the parameters as states."""

    name = "ekf"
    label = "extended Kalman filter"
    words = "Parameters as they emerge, sample by sample."
    brief = "in the order of time"
    place = 7
    simulates = True
    tells_convergence = True

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.kalman import estimate_by_kalman_filter

        return estimate_by_kalman_filter(problem)
