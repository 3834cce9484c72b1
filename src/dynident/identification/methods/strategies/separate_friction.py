"""Friction from runs of single joints, then the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Strategy, StrategyChoices

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class SeparateFriction(Strategy):
    """Friction from runs of single joints, then the rest."""

    name = "separate_friction"
    label = "friction first"
    words = "Friction from runs at constant speed (measurements whose role is friction), then the rest."
    brief = "friction first"
    place = 3
    friction_runs = True

    def solve(self, choices: StrategyChoices, problem: Problem) -> Fit:
        """Solve for friction first, then for the rest."""
        from dynident.identification.strategies.separate_friction import solve_separate_friction

        return solve_separate_friction(choices, problem)
