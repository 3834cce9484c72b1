"""Instrumental variables from a simulated robot."""

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
class InstrumentalVariables(Estimator):
    """Instrumental variables from a simulated robot."""

    name = "iv"
    label = "instrumental variables"
    words = "Unbiased where noisy encoders pull least squares off; simulates the robot a few times."
    brief = "instruments from a simulation"
    place = 5
    tells_convergence = True

    def solve(self, model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.simulating import instrumental_variables

        return instrumental_variables(model, choices, data, known)
