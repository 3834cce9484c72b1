"""Robust regression: rows that nothing explains lose their weight."""

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
class Robust(Estimator):
    """Robust regression."""

    name = "irls"
    label = "robust"
    words = "Rows that fit badly count less: for recordings with contacts, jumps or other outliers."
    brief = "robust"
    place = 3

    def solve(self, model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.robust import reweighted

        return reweighted(model, choices, data, known)
