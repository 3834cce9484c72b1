"""Base classes of estimators, strategies, equation types and priors, and their registries by name."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal, Protocol

from dynident.schema.registry import Registry, RegistryEntry

if TYPE_CHECKING:
    from dynident.identification.estimation_problem import Fit, Problem
    from dynident.recordings import Preprocessing

StepsName = Literal["link_by_link", "wrist_then_shoulder"]
"""Order in which the sequential strategy takes the joints."""
_HOME = "dynident.identification.methods"


@dataclass(frozen=True)
class Estimator(RegistryEntry, ABC):
    """An estimator solves the equations of the data for χ; its fields are the options that it alone takes.

    `from_reduced`: it needs the reduced data alone, and gives least squares of the joints' torques where these are its
    equations. `in_steps`: it solves any part of the equations. `weighted`: joints count by their noise;
    `weighs_turns`: so do rows where a joint turns round, apart from the joint's other rows.
    `simulates`: it integrates the dynamic model along the recordings. `possible_bodies`: its results are bodies that
    can exist; `possible_where_free`: its result is moved to such bodies where the fit hardly changes.
    `robust`: rows that the model does not explain lose their weight, so that its estimates and noise are not those of
    least squares of all rows. `tells_convergence`: its own warnings say whether it has settled. `priors`: names of
    those that it is compared with when methods are.
    """

    # Facts about the class and no options of a request: warnings, checks and messages ask them instead of names.
    from_reduced: ClassVar[bool] = False
    in_steps: ClassVar[bool] = False
    weighted: ClassVar[bool] = True
    weighs_turns: ClassVar[bool] = False
    simulates: ClassVar[bool] = False
    possible_bodies: ClassVar[bool] = False
    possible_where_free: ClassVar[bool] = False
    robust: ClassVar[bool] = False
    tells_convergence: ClassVar[bool] = False
    priors: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def solve(self, problem: Problem) -> Fit:
        """Solve all equations of the problem's data, with the prior knowledge of the parameters.

        Parameters
        ----------
        problem : Problem
            Equations of the data, and prior knowledge.

        Returns
        -------
        Fit
            The estimates with their uncertainty, and warnings.

        Raises
        ------
        DynidentError
            Where the data do not allow it.
        """


class StrategyChoices(Protocol):
    """What strategies need of `choices.IdentificationChoices`, which names a strategy itself."""

    @property
    def model(self) -> str:
        """Name of the equation type."""
        ...

    @property
    def rows(self) -> EquationType:
        """The equation type."""
        ...

    @property
    def solver(self) -> Estimator:
        """The estimator, with its options."""
        ...

    @property
    def steps(self) -> StepsName:
        """Order of the sequential strategy."""
        ...

    @property
    def preprocessing(self) -> Preprocessing | None:
        """The filters; None where the data decide."""
        ...


@dataclass(frozen=True)
class Strategy(RegistryEntry, ABC):
    """A strategy decides which data and which parameters are solved for at a time.

    `from_reduced`: it needs the reduced data alone. `at_once`: all parameters are found together, so that a prior on
    sums of them can be used. `friction_runs`: it uses tests of single joints' friction.
    """

    from_reduced: ClassVar[bool] = False
    at_once: ClassVar[bool] = False
    friction_runs: ClassVar[bool] = False

    @abstractmethod
    def solve(self, choices: StrategyChoices, problem: Problem) -> Fit:
        """Solve the problem part by part.

        Parameters
        ----------
        choices : IdentificationChoices
            What is identified, and how.
        problem : Problem
            Equations of the data, and prior knowledge.

        Returns
        -------
        Fit
            The estimates with their uncertainty, and warnings.

        Raises
        ------
        DynidentError
            Where the other choices or the data do not allow it.
        """


@dataclass(frozen=True)
class EquationType(RegistryEntry):
    """An equation type: what the rows of W are.

    `by_joint`: every joint has equations of its own.
    """

    by_joint: ClassVar[bool] = False


@dataclass(frozen=True)
class Prior(RegistryEntry):
    """A prior: which knowledge from the robot's description is used beside the data.

    `of_bodies`: a distance between bodies that can exist, which only an estimator of such bodies takes. `called`: its
    name within a sentence.
    """

    called: ClassVar[str] = ""
    of_bodies: ClassVar[bool] = False


# Each registry finds its kinds in one module, or in the modules of one package, and imports these only when the first
# kind is asked for.
ESTIMATORS: Registry[Estimator] = Registry(f"{_HOME}.estimator_options", Estimator, "estimator")
STRATEGIES: Registry[Strategy] = Registry(f"{_HOME}.equation_strategy_and_prior_options", Strategy, "strategy")
MODELS: Registry[EquationType] = Registry(f"{_HOME}.equation_strategy_and_prior_options", EquationType, "model")
PRIORS: Registry[Prior] = Registry(f"{_HOME}.equation_strategy_and_prior_options", Prior, "prior")
