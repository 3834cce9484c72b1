"""The sequential strategy [12.22]-[12.24]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Strategy, StrategyChoices

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class Sequential(Strategy):
    """The sequential strategy [12.22]-[12.24]."""

    name = "sequential"
    label = "one after another"
    words = "From the end of the arm to its base, with the errors of earlier steps carried on."
    brief = "one after another"
    place = 2
    from_reduced = True

    def solve(self, choices: StrategyChoices, problem: Problem) -> Fit:
        """Solve joint by joint, from the end of the arm to its base."""
        from dynident.identification.strategies.sequential import solve_sequentially

        return solve_sequentially(choices, problem)
