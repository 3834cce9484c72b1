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

    Parameters
    ----------
    model : str
        Equation type of the rows of W: "dynamic", "filtered", "power", "energy" or "base_wrench".
    strategy : str
        The order in which parameters are estimated: "global", "sequential" or "separate_friction".
    estimator : str or Estimator
        How they are estimated, by its name or with options of its own.
    prior : str or None
        Prior from the robot's description; None where the data alone count.
    steps : str
        Steps of the sequential strategy, "link_by_link" or "wrist_then_shoulder"; without a meaning for others.
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
            # Links without the prior have no meaning where there is none, and would be refused.
            free_links=() if self.prior is None else choices.free_links,
            steps=self.steps,
        )


def get_method(choices: IdentificationChoices) -> Method:
    """Return the method of an identification's choices.

    Parameters
    ----------
    choices : IdentificationChoices
        Options of an identification.

    Returns
    -------
    Method
        Its equation type, strategy, estimator and prior.
    """
    # Of other strategies the steps say nothing. One value for all of them makes equal methods compare equal.
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
        The methods, each once.
    """
    own = get_method(choices)
    methods = [own]
    methods += [
        Method(model, strategy, steps=steps)
        for model in MODELS.names
        for strategy in STRATEGIES.names
        # Both orders of the sequential strategy; the others count once.
        for steps in (get_args(StepsName) if strategy == "sequential" else get_args(StepsName)[:1])
    ]
    methods += [Method(choices.model, "global", estimator) for estimator in ESTIMATORS.names]
    methods += [
        Method(choices.model, "global", estimator.name, prior) for estimator in ESTIMATORS for prior in estimator.priors
    ]
    return tuple(dict.fromkeys(methods))
