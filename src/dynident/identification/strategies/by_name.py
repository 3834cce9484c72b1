"""The chosen strategy at work."""

from __future__ import annotations

from dataclasses import replace

from dynident.errors import DynidentError
from dynident.identification.choices import IdentificationChoices
from dynident.identification.equations.data import Data
from dynident.identification.fit import Fit
from dynident.regressors.model import Model


def fit(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """Solve by the chosen strategy with the chosen estimator."""
    if choices.prior is not None and not choices.plan.at_once:
        raise DynidentError(
            f"the prior speaks of sums of parameters that the {choices.strategy} strategy finds one after the other; "
            "choose the global strategy, or leave the prior out",
            pointer="/prior",
            title="Choices that do not fit",
        )
    found = choices.plan.solve(model, choices, data)
    if not data.friction or choices.plan.friction_runs:
        return found
    names = ", ".join(recording.name for recording in data.friction)
    unused = f"Not used: {names}. Tests of friction (role friction) serve the strategy separate_friction alone."
    return replace(found, warnings=(*found.warnings, unused))
