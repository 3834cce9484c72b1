"""Physically feasible parameters: those of bodies that can exist, nearest to the data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class Feasible(Estimator):
    """Physically feasible parameters."""

    name = "feasible"
    label = "physically feasible"
    words = "Only bodies that can exist: for motions that do not determine everything, and for simulators."
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
