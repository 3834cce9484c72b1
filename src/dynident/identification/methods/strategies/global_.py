"""All parameters from all data: one system of equations (§12.3.3 i, §12.4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Strategy, StrategyChoices

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


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
