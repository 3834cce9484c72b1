"""The strategy and the estimator of an identification, by their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from dynident.estimation import Information, Solution, Statistics, ordinary, statistics, weighted
from dynident.identification.choices import EstimatorName, IdentificationChoices, StrategyName
from dynident.identification.data import Data
from dynident.regressors.model import Model


@dataclass(frozen=True, eq=False)
class Fit:
    """Estimates, how sure they are, and what the user must be told about how they came about."""

    solution: Solution
    statistics: Statistics
    warnings: tuple[str, ...] = ()


Estimator = Callable[[Model, IdentificationChoices, Data, Information | None], Fit]
"""Solves the equations of the data; the last argument is what is known of the parameters beside them."""

Strategy = Callable[[Model, IdentificationChoices, Data], Fit]
"""Decides which data and which parameters are solved for at a time."""


def fit(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """Solve by the chosen strategy with the chosen estimator."""
    return STRATEGIES[choices.strategy](model, choices, data)


def estimate(model: Model, choices: IdentificationChoices, data: Data, known: Information | None = None) -> Fit:
    """Solve all equations of the data with the chosen estimator."""
    return ESTIMATORS[choices.estimator](model, choices, data, known)


def _ordinary(model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
    solution = ordinary(data.equations, known)
    return Fit(solution, statistics(data.equations, solution))


def _weighted(model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
    solution = weighted(data.equations, known)
    return Fit(solution, statistics(data.equations, solution))


def _global(model: Model, choices: IdentificationChoices, data: Data) -> Fit:
    """One system of equations for all parameters (§12.3.3 i, §12.4)."""
    return estimate(model, choices, data)


ESTIMATORS: Mapping[EstimatorName, Estimator] = MappingProxyType({"ols": _ordinary, "wls": _weighted})

STRATEGIES: Mapping[StrategyName, Strategy] = MappingProxyType({"global": _global})
