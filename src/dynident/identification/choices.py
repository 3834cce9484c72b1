"""The four independent choices of an identification: effects, model, strategy, estimator; and the preprocessing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from types import MappingProxyType
from typing import Literal, get_args

from dynident.effects import DEFAULT_EFFECTS, EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import CovarianceName
from dynident.recordings import Preprocessing
from dynident.regressors.base_parameters import DEFAULT_TOLERANCE
from dynident.robot.usual_errors import USUAL_SHARE

ModelName = Literal["dynamic", "filtered", "energy", "power", "base_wrench"]
StrategyName = Literal["global", "sequential", "separate_friction"]
EstimatorName = Literal["ols", "wls", "irls", "feasible", "iv", "didim", "ekf"]
StepsName = Literal["link_by_link", "wrist_then_shoulder"]
PriorName = Literal["description", "description_entropic"]

AVAILABLE_MODELS: tuple[ModelName, ...] = ("dynamic", "filtered", "energy", "power", "base_wrench")
AVAILABLE_STRATEGIES: tuple[StrategyName, ...] = ("global", "sequential", "separate_friction")
AVAILABLE_ESTIMATORS: tuple[EstimatorName, ...] = ("ols", "wls", "irls", "feasible", "iv", "didim", "ekf")
AVAILABLE_COVARIANCES: tuple[CovarianceName, ...] = ("by_time_and_joints", "by_joint", "independent")
AVAILABLE_PRIORS: tuple[PriorName, ...] = ("description", "description_entropic")
PRIOR_WORDS: Mapping[PriorName, str] = MappingProxyType(
    {"description": "description", "description_entropic": "description (entropic)"}
)


@dataclass(frozen=True)
class IdentificationChoices:
    """What is identified and how.

    `steps` are those of the sequential strategy; `prior` None: the data alone count; `free_links`, by their joints, are
    those that the prior is not believed of, for instance the last one where it carries an unknown payload, and
    `prior_error` the share by which the others are usually off (see `usual_errors` and, for description_entropic, whose
    distance is the same in every frame, `entropic`). `pole` is a of [12.29] in rad/s,
    for the filtered model, `interval` t_b - t_a of [12.43] in s, for the energy model, `preprocessing` the filters:
    None where the data decide. `tolerance` decides which columns count as dependent. `covariance`: what of the
    residuals is taken to be correlated (`estimation.statistics`).
    """

    effects: tuple[EffectChoice, ...] = DEFAULT_EFFECTS
    model: ModelName = "dynamic"
    strategy: StrategyName = "global"
    estimator: EstimatorName = "wls"
    steps: StepsName = "link_by_link"
    prior: PriorName | None = None
    free_links: tuple[str, ...] = ()
    prior_error: float = USUAL_SHARE
    pole: float | None = None
    interval: float | None = None
    preprocessing: Preprocessing | None = None
    tolerance: float = DEFAULT_TOLERANCE
    covariance: CovarianceName = "by_time_and_joints"

    def __post_init__(self) -> None:
        _known("model", self.model, get_args(ModelName), AVAILABLE_MODELS)
        _known("strategy", self.strategy, get_args(StrategyName), AVAILABLE_STRATEGIES)
        _known("estimator", self.estimator, get_args(EstimatorName), AVAILABLE_ESTIMATORS)
        _known("covariance", self.covariance, get_args(CovarianceName), AVAILABLE_COVARIANCES)
        _known("steps", self.steps, get_args(StepsName), get_args(StepsName))
        if self.prior is not None:
            _known("prior", self.prior, get_args(PriorName), AVAILABLE_PRIORS)
            if self.prior == "description_entropic" and self.estimator != "feasible":
                raise DynidentError(
                    f"the entropic prior is a distance between bodies that can exist: it goes with the estimator "
                    f"feasible, not {self.estimator}; choose that, or the prior description",
                    pointer="/prior",
                    title="Choices that do not fit",
                )
        elif self.free_links:
            raise DynidentError(
                "free_links are links that the prior is not believed of, and there is no prior; choose description, or "
                "leave them out",
                pointer="/free_links",
            )
        if not (isfinite(self.prior_error) and self.prior_error > 0):
            raise DynidentError(
                f"prior_error is {self.prior_error}; give the share by which the description's inertias are usually "
                "off, above zero: 0.2 for a fifth",
                pointer="/prior_error",
            )
        if self.pole is not None and not (isfinite(self.pole) and self.pole > 0):
            raise DynidentError(f"pole is {self.pole}; give a of [12.29] in rad/s, above zero", pointer="/pole")
        if self.interval is not None and not (isfinite(self.interval) and self.interval > 0):
            raise DynidentError(
                f"interval is {self.interval}; give t_b - t_a of [12.43] in s, above zero", pointer="/interval"
            )


def _known(what: str, value: str, words: tuple[str, ...], available: tuple[str, ...]) -> None:
    if value in available:
        return
    state = "is not available in this version" if value in words else f"is no {what}"
    choice = f"choose from: {', '.join(available)}" if available else "leave it out"
    raise DynidentError(f"{value!r} {state}; {choice}", pointer=f"/{what}")
