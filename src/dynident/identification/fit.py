"""What an estimator and a strategy give."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dynident.estimation import Information, Solution, Statistics
from dynident.identification.choices import IdentificationChoices
from dynident.identification.data import Data
from dynident.identification.standard import StandardParameters
from dynident.regressors.model import Model


@dataclass(frozen=True, eq=False)
class Fit:
    """Estimates, how sure they are, and what the user must be told about how they came about.

    `standard`: the standard parameters, where the estimator solves for these.
    """

    solution: Solution
    statistics: Statistics
    warnings: tuple[str, ...] = ()
    standard: StandardParameters | None = None


Estimator = Callable[[Model, IdentificationChoices, Data, Information | None], Fit]
"""Solves the equations of the data; the last argument is what is known of the parameters beside them."""

Strategy = Callable[[Model, IdentificationChoices, Data], Fit]
"""Decides which data and which parameters are solved for at a time."""
