"""The ways to identify that there are: model, strategy, estimator, prior."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

from dynident.identification.choices import (
    AVAILABLE_ESTIMATORS,
    AVAILABLE_MODELS,
    AVAILABLE_STRATEGIES,
    PRIOR_WORDS,
    EstimatorName,
    IdentificationChoices,
    ModelName,
    PriorName,
    StepsName,
    StrategyName,
)

# Estimators on reduced data, which prior knowledge can be put beside.
_WITH_PRIOR: tuple[tuple[EstimatorName, PriorName], ...] = (
    ("wls", "description"),
    ("feasible", "description"),
    ("feasible", "description_entropic"),
)


@dataclass(frozen=True)
class Method:
    """One way to identify: the rows, the strategy, the estimator, and what is known beforehand.

    `steps` are those of the sequential strategy; of another they say nothing.
    """

    model: ModelName = "dynamic"
    strategy: StrategyName = "global"
    estimator: EstimatorName = "wls"
    prior: PriorName | None = None
    steps: StepsName = "link_by_link"

    @property
    def words(self) -> str:
        """The method as a person names it."""
        strategy = self.steps if self.strategy == "sequential" else self.strategy
        names = f"{self.model}, {strategy}, {self.estimator}".replace("_", " ")
        return names if self.prior is None else f"{names}, prior from the {PRIOR_WORDS[self.prior]}"

    def of(self, choices: IdentificationChoices) -> IdentificationChoices:
        """These choices with this method."""
        return replace(
            choices,
            model=self.model,
            strategy=self.strategy,
            estimator=self.estimator,
            prior=self.prior,
            free_links=() if self.prior is None else choices.free_links,
            steps=self.steps,
        )


def method_of(choices: IdentificationChoices) -> Method:
    """The method that an identification chose."""
    steps = choices.steps if choices.strategy == "sequential" else Method.steps
    return Method(choices.model, choices.strategy, choices.estimator, choices.prior, steps)


def available_methods(choices: IdentificationChoices) -> tuple[Method, ...]:
    """Each model with every strategy, and each estimator, with and without a prior, on the choices' own model.

    The method of the choices comes first.
    """
    own = method_of(choices)
    found = [own]
    found += [
        Method(model, strategy, steps=steps)
        for model in AVAILABLE_MODELS
        for strategy in AVAILABLE_STRATEGIES
        for steps in (get_args(StepsName) if strategy == "sequential" else get_args(StepsName)[:1])
    ]
    found += [Method(choices.model, "global", estimator) for estimator in AVAILABLE_ESTIMATORS]
    found += [Method(choices.model, "global", estimator, prior) for estimator, prior in _WITH_PRIOR]
    return tuple(dict.fromkeys(found))
