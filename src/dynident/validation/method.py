"""A method of identification (equation type, strategy, estimator, prior), and all methods that are available."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import get_args

from dynident.identification.choices import STEPS, EstimatorName, IdentificationChoices, PriorName, StrategyName
from dynident.identification.methods.bases import ESTIMATORS, MODELS, PRIORS, STRATEGIES, Estimator, StepsName
from dynident.identification.problem_options import ModelName
from dynident.schema.fields import declare_field
from dynident.schema.registry import format_kind


@dataclass(frozen=True)
class Method:
    """One way to identify: the rows, the strategy, the estimator, and what is known beforehand.

    `steps` are those of the sequential strategy; of another they say nothing.
    """

    model: ModelName = declare_field(default="dynamic", kinds=MODELS)
    strategy: StrategyName = declare_field(default="global", kinds=STRATEGIES)
    estimator: EstimatorName | Estimator = declare_field(default="wls", kinds=ESTIMATORS)
    prior: PriorName | None = declare_field(default=None, kinds=PRIORS)
    steps: StepsName = declare_field("Of the sequential strategy", default="link_by_link", kinds=STEPS)

    @property
    def words(self) -> str:
        """Name of the method for people."""
        strategy = self.steps if self.strategy == "sequential" else self.strategy
        names = f"{self.model}, {strategy}, {format_kind(self.estimator)}".replace("_", " ")
        return names if self.prior is None else f"{names}, prior from the {PRIORS.get(self.prior).called}"

    def apply_to(self, choices: IdentificationChoices) -> IdentificationChoices:
        """Return these choices with this method."""
        return replace(
            choices,
            model=self.model,
            strategy=self.strategy,
            estimator=self.estimator,
            prior=self.prior,
            free_links=() if self.prior is None else choices.free_links,
            steps=self.steps,
        )


def get_method(choices: IdentificationChoices) -> Method:
    """Return the method of an identification's choices."""
    steps = choices.steps if choices.strategy == "sequential" else "link_by_link"
    return Method(choices.model, choices.strategy, choices.estimator, choices.prior, steps)


def available_methods(choices: IdentificationChoices) -> tuple[Method, ...]:
    """List each equation type with every strategy, and each estimator with and without a prior.

    Parameters
    ----------
    choices : IdentificationChoices
        Their own method comes first; estimators and priors go with their own equation type.

    Returns
    -------
    tuple of Method
    """
    own = get_method(choices)
    methods = [own]
    methods += [
        Method(model, strategy, steps=steps)
        for model in MODELS.names
        for strategy in STRATEGIES.names
        for steps in (get_args(StepsName) if strategy == "sequential" else get_args(StepsName)[:1])
    ]
    methods += [Method(choices.model, "global", estimator) for estimator in ESTIMATORS.names]
    methods += [
        Method(choices.model, "global", estimator.name, prior) for estimator in ESTIMATORS for prior in estimator.priors
    ]
    return tuple(dict.fromkeys(methods))
