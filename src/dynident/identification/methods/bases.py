"""What an estimator, a strategy, a model and a prior are, and all of them by their names."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from dynident.kinds import Kind, Kinds

if TYPE_CHECKING:
    from dynident.identification.choices import IdentificationChoices
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem

_HOME = "dynident.identification.methods"


@dataclass(frozen=True)
class Estimator(Kind, ABC):
    """Solves the equations of the data for χ; a dataclass whose fields are the options that it alone takes.

    `from_reduced`: it needs the reduced data alone, and gives least squares of the joints' torques where these are its
    equations. `in_steps`: it solves any part of the equations. `weighted`: joints count by their noise;
    `weighs_turns`: so do rows where a joint turns round, beside its others.
    `simulates`: it integrates the dynamic model along the recordings. `possible_bodies`: what it finds are bodies that
    can exist; `possible_where_free`: it is moved to such where the fit hardly changes. `tells_convergence`: its own
    warnings say whether it has settled. `priors`: names of those that it is compared with when methods are.
    """

    from_reduced: ClassVar[bool] = False
    in_steps: ClassVar[bool] = False
    weighted: ClassVar[bool] = True
    weighs_turns: ClassVar[bool] = False
    simulates: ClassVar[bool] = False
    possible_bodies: ClassVar[bool] = False
    possible_where_free: ClassVar[bool] = False
    tells_convergence: ClassVar[bool] = False
    priors: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def solve(self, problem: Problem) -> Fit:
        """Solve all equations of the problem's data, with what is known of the parameters beside them.

        Raises
        ------
        DynidentError
            Where the data do not allow it.
        """


@dataclass(frozen=True)
class Strategy(Kind, ABC):
    """Decides which data and which parameters are solved for at a time.

    `from_reduced`: it needs the reduced data alone. `at_once`: all parameters are found together, so that a prior on
    sums of them can be believed. `friction_runs`: it uses tests of single joints' friction.
    """

    from_reduced: ClassVar[bool] = False
    at_once: ClassVar[bool] = False
    friction_runs: ClassVar[bool] = False

    @abstractmethod
    def solve(self, choices: IdentificationChoices, problem: Problem) -> Fit:
        """Solve the problem part by part; `DynidentError` where the other choices or the data do not allow it."""


@dataclass(frozen=True)
class RowsModel(Kind):
    """What the rows of W are.

    `by_joint`: every joint has equations of its own.
    """

    by_joint: ClassVar[bool] = False


@dataclass(frozen=True)
class Prior(Kind):
    """What is believed of the robot's description.

    `of_bodies`: a distance between bodies that can exist, which only an estimator of such takes. `called`: its name
    within a sentence.
    """

    called: ClassVar[str] = ""
    of_bodies: ClassVar[bool] = False


ESTIMATORS: Kinds[Estimator] = Kinds(f"{_HOME}.estimators", Estimator, "estimator")
STRATEGIES: Kinds[Strategy] = Kinds(f"{_HOME}.strategies", Strategy, "strategy")
MODELS: Kinds[RowsModel] = Kinds(f"{_HOME}.models", RowsModel, "model")
PRIORS: Kinds[Prior] = Kinds(f"{_HOME}.priors", Prior, "prior")
