"""The estimators that can be chosen, with names and options; a new one is a class here or in another file.

The first ones solve by least squares: ordinary, weighted, robust and physically feasible. The others simulate the
robot: instrumental variables, output error (DIDIM) and a Kalman filter.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.base_classes import Estimator

if TYPE_CHECKING:
    from dynident.identification.estimation_problem import Fit, Problem


@dataclass(frozen=True)
class Feasible(Estimator):
    """Physically feasible parameters."""

    name = "feasible"
    label = "physically feasible"
    words = (
        "Gives only physically possible links: for motions that do not determine all parameters, and for simulators."
    )
    brief = "physically possible links"
    place = 4
    from_reduced = True
    weighs_turns = True
    possible_bodies = True
    priors = ("description", "description_entropic")

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.feasible import solve_feasible

        return solve_feasible(problem)


@dataclass(frozen=True)
class Robust(Estimator):
    """Robust regression."""

    name = "irls"
    label = "robust"
    words = "Rows with large residuals have less weight: for recordings with contacts, jumps or other outliers."
    brief = "robust"
    place = 3
    robust = True

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.robust import estimate_robustly

        return estimate_robustly(problem)


@dataclass(frozen=True)
class Ordinary(Estimator):
    """Ordinary least squares [12.5]."""

    name = "ols"
    label = "ordinary least squares"
    words = "All joints have the same weight [12.5], so joints with large torques dominate."
    brief = "all joints with the same weight"
    place = 2
    from_reduced = True
    in_steps = True
    weighted = False

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.estimation import solve_ordinary, statistics
        from dynident.identification.estimation_problem import Fit
        from dynident.parallel import defer

        solution = solve_ordinary(problem.data.equations, problem.known)
        return Fit(solution, defer(lambda: statistics(problem.data.equations, solution, problem.covariance)))


@dataclass(frozen=True)
class Weighted(Estimator):
    """Weighted least squares."""

    name = "wls"
    label = "weighted least squares"
    words = "Each joint weighted by its noise. The parameters may be physically impossible."
    brief = "each joint weighted by its noise"
    place = 1
    from_reduced = True
    weighs_turns = True
    in_steps = True
    priors = ("description",)

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.estimation import solve_weighted, statistics
        from dynident.identification.estimation_problem import Fit
        from dynident.parallel import defer

        solution = solve_weighted(problem.data.equations, problem.known)
        return Fit(solution, defer(lambda: statistics(problem.data.equations, solution, problem.covariance)))


@dataclass(frozen=True)
class Auto(Weighted):
    """Weighted least squares that are feasible where that is free."""

    name = "auto"
    label = "weighted least squares, feasible where free"
    words = "Weighted least squares, made physically feasible if the fit hardly changes. The usual choice."
    brief = "wls, made feasible if the error grows by less than 2 %"
    place = 0
    possible_where_free = True


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
        from dynident.identification.estimators.instrumental_variables_and_output_error import estimate_by_output_error

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
        from dynident.identification.estimators.instrumental_variables_and_output_error import (
            estimate_by_instrumental_variables,
        )

        return estimate_by_instrumental_variables(problem)
