"""The equation types, strategies [12.22]-[12.24] and priors that can be chosen, with their options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.base_classes import EquationType, Prior, Strategy, StrategyChoices

if TYPE_CHECKING:
    from dynident.identification.estimation_problem import Fit, Problem


@dataclass(frozen=True)
class Power(EquationType):
    """Rows of the power model [12.51]."""

    name = "power"
    label = "power"
    words = (
        "One row per sample [12.51]: no interval to choose, and offsets do not accumulate; needs a more exciting "
        "motion."
    )
    brief = "energy rate"
    place = 4


@dataclass(frozen=True)
class Filtered(EquationType):
    """Rows of the filtered dynamic model [12.28], with `pole`."""

    name = "filtered"
    label = "filtered dynamic"
    words = "Like the dynamic model, but without accelerations [12.28]: for noisy encoders."
    brief = "without accelerations"
    place = 2
    by_joint = True


@dataclass(frozen=True)
class Energy(EquationType):
    """Rows of the energy model [12.43], with `interval`."""

    name = "energy"
    label = "energy"
    words = "One row per interval [12.43]: needs no accelerations or filters, but a more exciting motion."
    brief = "over intervals"
    place = 3


@dataclass(frozen=True)
class BaseWrench(EquationType):
    """Six rows from a force-torque sensor under the base."""

    name = "base_wrench"
    label = "base wrench"
    words = "Six rows per sample from a force-torque sensor under the base: joint friction does not appear in them."
    brief = "a force-torque sensor under the base"
    place = 5


@dataclass(frozen=True)
class Dynamic(EquationType):
    """Rows of the dynamic model [12.18]."""

    name = "dynamic"
    label = "dynamic"
    words = "One row per joint and sample [12.18]: shows the parameters best. The usual choice."
    brief = "joint torques"
    place = 1
    by_joint = True


@dataclass(frozen=True)
class SeparateFriction(Strategy):
    """Friction from runs of single joints, then the rest."""

    name = "separate_friction"
    label = "friction first"
    words = "First friction from recordings at constant speed (role friction), then the other parameters."
    brief = "friction first"
    place = 3
    friction_runs = True

    def solve(self, choices: StrategyChoices, problem: Problem) -> Fit:
        """Solve for friction first, then for the rest."""
        from dynident.identification.strategies.separate_friction import solve_separate_friction

        return solve_separate_friction(choices, problem)


@dataclass(frozen=True)
class AllAtOnce(Strategy):
    """All parameters from all data: one system of equations (§12.3.3 i, §12.4)."""

    name = "global"
    label = "all at once"
    words = "All parameters from all data. The usual choice."
    brief = "all at once"
    place = 1
    from_reduced = True
    at_once = True

    def solve(self, choices: StrategyChoices, problem: Problem) -> Fit:
        """Solve for all parameters from all data."""
        return choices.solver.solve(problem)


@dataclass(frozen=True)
class Sequential(Strategy):
    """The sequential strategy [12.22]-[12.24]."""

    name = "sequential"
    label = "one after another"
    words = "From the end of the arm to its base; each step includes the uncertainty of earlier steps."
    brief = "one after another"
    place = 2
    from_reduced = True

    def solve(self, choices: StrategyChoices, problem: Problem) -> Fit:
        """Solve joint by joint, from the end of the arm to its base."""
        from dynident.identification.strategies.sequential import solve_sequentially

        return solve_sequentially(choices, problem)


@dataclass(frozen=True)
class EntropicDescription(Prior):
    """The bodies of the robot's description, the same in every frame."""

    name = "description_entropic"
    label = "the description's bodies (entropic)"
    words = "Uses the bodies of the description, independent of the frame; needs the estimator physically feasible."
    brief = "bodies, independent of the frame; with the estimator feasible"
    place = 2
    called = "description (entropic)"
    of_bodies = True


@dataclass(frozen=True)
class Description(Prior):
    """The inertias of the robot's description."""

    name = "description"
    label = "the description's inertias"
    words = "Uses the inertias of the robot's description with their usual errors: for small motions."
    brief = "its inertias"
    place = 1
    called = "description"
