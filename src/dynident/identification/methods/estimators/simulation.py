"""Estimators that simulate the robot: instrumental variables, output error (DIDIM), and a Kalman filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class Kalman(Estimator):
    """An extended Kalman filter with the parameters as states."""

    name = "ekf"
    label = "extended Kalman filter"
    words = "Updates the parameters sample by sample."
    brief = "sample by sample in time"
    place = 7
    simulates = True
    tells_convergence = True

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.kalman import estimate_by_kalman_filter

        return estimate_by_kalman_filter(problem)


@dataclass(frozen=True)
class OutputError(Estimator):
    """Output error of the torque of a simulated robot (DIDIM)."""

    name = "didim"
    label = "output error (DIDIM)"
    words = "Compares measured with simulated torque; needs measured positions only for the first guess."
    brief = "measured compared with simulated torque"
    place = 6
    simulates = True
    tells_convergence = True

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        # Imported late, here and in its neighbours: the command line lists all estimators without loading the
        # numerics.
        from dynident.identification.estimators.simulated_regressors import estimate_by_output_error

        return estimate_by_output_error(problem)


@dataclass(frozen=True)
class InstrumentalVariables(Estimator):
    """Instrumental variables from a simulated robot."""

    name = "iv"
    label = "instrumental variables"
    words = "Unbiased when noisy encoders bias least squares; simulates the robot a few times."
    brief = "instruments from a simulation"
    place = 5
    simulates = True
    tells_convergence = True

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.simulated_regressors import estimate_by_instrumental_variables

        return estimate_by_instrumental_variables(problem)
