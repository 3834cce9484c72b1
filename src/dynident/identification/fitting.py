"""The strategies by their names."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dynident.identification.choices import IdentificationChoices, StrategyName
from dynident.identification.data import Data
from dynident.identification.estimators import estimate
from dynident.identification.fit import Fit, Strategy
from dynident.identification.sequential import sequential
from dynident.regressors.model import Model

__all__ = ["STRATEGIES", "Fit", "estimate", "fit"]


def fit(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """Solve by the chosen strategy with the chosen estimator."""
    return STRATEGIES[choices.strategy](model, choices, data)


def _global(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """One system of equations for all parameters (§12.3.3 i, §12.4)."""
    return estimate(model, choices, data)


STRATEGIES: Mapping[StrategyName, Strategy] = MappingProxyType({"global": _global, "sequential": sequential})
