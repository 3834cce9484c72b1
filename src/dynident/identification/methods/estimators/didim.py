"""DIDIM: output error of the torque of a simulated robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class OutputError(Estimator):
    """Output error of the torque of a simulated robot (DIDIM)."""

    name = "didim"
    label = "output error (DIDIM)"
    words = "Compares measured with simulated torque; needs positions for the first guess alone."
    brief = "simulated against measured torque"
    place = 6
    simulates = True
    tells_convergence = True

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        # Imported late, here and in its neighbours: the command line lists all estimators without loading the
        # numerics.
        from dynident.identification.estimators.simulated_regressors import estimate_by_output_error

        return estimate_by_output_error(problem)
