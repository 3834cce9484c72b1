"""Robust regression: rows that nothing explains lose their weight."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.identification.methods.bases import Estimator

if TYPE_CHECKING:
    from dynident.identification.fit import Fit
    from dynident.identification.problem import Problem


@dataclass(frozen=True)
class Robust(Estimator):
    """Robust regression."""

    name = "irls"
    label = "robust"
    words = "Rows that fit badly count less: for recordings with contacts, jumps or other outliers."
    brief = "robust"
    place = 3

    def solve(self, problem: Problem) -> Fit:
        """Solve the equations of the data."""
        from dynident.identification.estimators.robust import estimate_robustly

        return estimate_robustly(problem)
