"""The four independent choices of an identification: effects, model, strategy, estimator; and the preprocessing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from dynident.effects import DEFAULT_EFFECTS, EffectChoice
from dynident.errors import DynidentError
from dynident.recordings import Preprocessing
from dynident.regressors.base_parameters import DEFAULT_TOLERANCE

ModelName = Literal["dynamic", "filtered", "energy", "power", "base_wrench"]
StrategyName = Literal["global", "sequential", "separate_friction"]
EstimatorName = Literal["ols", "wls", "irls", "feasible", "iv"]

AVAILABLE_MODELS: tuple[ModelName, ...] = ("dynamic",)
AVAILABLE_STRATEGIES: tuple[StrategyName, ...] = ("global",)
AVAILABLE_ESTIMATORS: tuple[EstimatorName, ...] = ("ols", "wls")


@dataclass(frozen=True)
class IdentificationChoices:
    """What is identified and how.

    `preprocessing` None: chosen from the data. `tolerance` decides which columns count as dependent.
    """

    effects: tuple[EffectChoice, ...] = DEFAULT_EFFECTS
    model: ModelName = "dynamic"
    strategy: StrategyName = "global"
    estimator: EstimatorName = "wls"
    preprocessing: Preprocessing | None = None
    tolerance: float = DEFAULT_TOLERANCE

    def __post_init__(self) -> None:
        _known("model", self.model, get_args(ModelName), AVAILABLE_MODELS)
        _known("strategy", self.strategy, get_args(StrategyName), AVAILABLE_STRATEGIES)
        _known("estimator", self.estimator, get_args(EstimatorName), AVAILABLE_ESTIMATORS)


def _known(what: str, value: str, words: tuple[str, ...], available: tuple[str, ...]) -> None:
    if value in available:
        return
    state = "is not available in this version" if value in words else f"is no {what}"
    raise DynidentError(f"{value!r} {state}; choose from: {', '.join(available)}", pointer=f"/{what}")
