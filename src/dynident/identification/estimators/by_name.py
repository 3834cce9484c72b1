"""The estimators by their names."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from dynident.estimation import Information, ordinary, statistics, weighted
from dynident.identification.choices import EstimatorName, IdentificationChoices
from dynident.identification.data import Data
from dynident.identification.estimators.feasible import feasible
from dynident.identification.estimators.kalman import kalman
from dynident.identification.estimators.robust import reweighted
from dynident.identification.estimators.simulating import instrumental_variables, output_error
from dynident.identification.fit import Estimator, Fit
from dynident.regressors.model import Model


def estimate(model: Model, choices: IdentificationChoices, data: Data, known: Information | None = None) -> Fit:
    """Solve all equations of the data with the chosen estimator."""
    return ESTIMATORS[choices.estimator](model, choices, data, known)


def _ordinary(model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
    solution = ordinary(data.equations, known)
    return Fit(solution, statistics(data.equations, solution, choices.covariance))


def _weighted(model: Model, choices: IdentificationChoices, data: Data, known: Information | None) -> Fit:
    solution = weighted(data.equations, known)
    return Fit(solution, statistics(data.equations, solution, choices.covariance))


ESTIMATORS: Mapping[EstimatorName, Estimator] = MappingProxyType(
    {
        "ols": _ordinary,
        "wls": _weighted,
        "irls": reweighted,
        "feasible": feasible,
        "iv": instrumental_variables,
        "didim": output_error,
        "ekf": kalman,
    }
)
