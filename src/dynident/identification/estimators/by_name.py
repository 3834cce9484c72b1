"""The chosen estimator at work."""

from __future__ import annotations

from dynident.estimation import Information
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.data import Data
from dynident.identification.fit import Fit
from dynident.regressors.model import Model


def estimate(model: Model, choices: IdentificationChoices, data: Data, known: Information | None = None) -> Fit:
    """Solve all equations of the data with the chosen estimator."""
    return choices.solver.solve(model, choices, data, known)
