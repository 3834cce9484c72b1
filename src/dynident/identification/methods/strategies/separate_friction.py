"""Friction from runs of single joints, then the rest."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Strategy

if TYPE_CHECKING:
    from dynident.identification.choices import IdentificationChoices
    from dynident.identification.equations.data import Data
    from dynident.identification.fit import Fit
    from dynident.regressors.model import Model


@dataclass(frozen=True)
class SeparateFriction(Strategy):
    """Friction from runs of single joints, then the rest."""

    name = "separate_friction"
    label = "friction first"
    words = "Friction from runs at constant speed (measurements whose role is friction), then the rest."
    brief = "friction first"
    place = 3
    friction_runs = True

    def solve(self, model: Model, choices: IdentificationChoices, data: Data) -> Fit:
        """Solve the data part by part."""
        from dynident.identification.strategies.separate_friction import separate_friction

        return separate_friction(model, choices, data)
