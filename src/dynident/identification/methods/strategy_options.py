"""The strategies that can be chosen: global, sequential [12.22]-[12.24], friction first, with their options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.base_classes import Strategy, StrategyChoices

if TYPE_CHECKING:
    from dynident.identification.estimation_problem import Fit, Problem


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
