"""The strategies by their names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

from dynident.errors import DynidentError
from dynident.identification.choices import IdentificationChoices, StrategyName
from dynident.identification.data import Data
from dynident.identification.estimators.by_name import estimate
from dynident.identification.fit import Fit, Strategy
from dynident.identification.prior import prior_of, with_prior_said
from dynident.identification.strategies.separate_friction import separate_friction
from dynident.identification.strategies.sequential import sequential
from dynident.regressors.model import Model

__all__ = ["STRATEGIES", "Fit", "estimate", "fit"]


def fit(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """Solve by the chosen strategy with the chosen estimator."""
    if choices.prior is not None and choices.strategy != "global":
        raise DynidentError(
            f"the prior speaks of sums of parameters that the {choices.strategy} strategy finds one after the other; "
            "choose the global strategy, or leave the prior out",
            pointer="/prior",
            title="Choices that do not fit",
        )
    found = STRATEGIES[choices.strategy](model, choices, data)
    if not data.friction or choices.strategy == "separate_friction":
        return found
    names = ", ".join(recording.name for recording in data.friction)
    unused = f"Not used: {names}. Tests of friction (role friction) serve the strategy separate_friction alone."
    return replace(found, warnings=(*found.warnings, unused))


def _global(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """One system of equations for all parameters (§12.3.3 i, §12.4)."""
    return with_prior_said(model, data, estimate(model, choices, data, prior_of(model, choices)), choices)


STRATEGIES: Mapping[StrategyName, Strategy] = MappingProxyType(
    {"global": _global, "sequential": sequential, "separate_friction": separate_friction}
)
