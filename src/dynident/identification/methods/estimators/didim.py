"""DIDIM: output error of the torque of a simulated robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.estimation import Information
    from dynident.identification.choices import IdentificationChoices
    from dynident.identification.equations.data import Data
    from dynident.identification.fit import Fit
    from dynident.regressors.model import Model


@dataclass(frozen=True)
class OutputError(Estimator):
    """DIDIM."""

    name = "didim"
    label = "output error (DIDIM)"
    words = "Compares measured with simulated torque; needs positions for the first guess alone."
    brief = "simulated against measured torque"
    place = 6
    tells_convergence = True

    def solve(self, model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.simulating import output_error

        return output_error(model, choices, data, known)
