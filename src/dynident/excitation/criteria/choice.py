"""The criterion that is asked for, by its name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from dynident.effects import EffectChoice
from dynident.errors import DynidentError

CRITERIA = (
    "condition_number",
    "equilibrated",
    "condition_plus_inverse_sigma",
    "weighted",
    "d_optimal",
    "a_optimal",
    "e_optimal",
    "parameters",
    "separation",
)
"""Names of the criteria."""


@dataclass(frozen=True)
class CriterionChoice:
    """A criterion by name.

    Parameters
    ----------
    name : str
        One of `CRITERIA`.
    weight : float
        k1 of [12.13] or k2 of [12.14] (in the unit of the smallest singular value).
    a_priori : mapping of parameter name to value
        |Z| of [12.15]; parameters that it leaves out take the value that the robot's description gives. "parameters"
        and "separation" measure variances by them.
    parameters : tuple of str
        For "parameters": names of the base parameters whose variances count.
    effects : tuple of EffectChoice
        For "separation": the effects that are to be told from the rest of the model and from each other.
    """

    name: str = "condition_number"
    weight: float = 1.0
    a_priori: Mapping[str, float] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    effects: tuple[EffectChoice, ...] = ()


def check_criterion(choice: CriterionChoice) -> None:
    """Raise `DynidentError` for a name that is none, or a weight that is not a positive number."""
    if choice.name not in CRITERIA:
        raise DynidentError(
            f"there is no criterion {choice.name!r}; there are: {', '.join(CRITERIA)}",
            pointer="/criterion/name",
            title="Unknown criterion",
        )
    if not (np.isfinite(choice.weight) and choice.weight > 0):
        raise DynidentError(
            f"the weight of the criterion is {choice.weight}; it must be a positive number", pointer="/criterion/weight"
        )
    for name, value in choice.a_priori.items():
        if not (np.isfinite(value) and value != 0):
            raise DynidentError(
                f"the a-priori value of {name} is {value}; it must be a number other than zero",
                pointer="/criterion/a_priori",
            )


def check_wishes(choice: CriterionChoice) -> None:
    """Raise `DynidentError` where a criterion needs names that are not stated."""
    if choice.name == "parameters" and not choice.parameters:
        raise DynidentError("name the parameters whose variances count", pointer="/criterion/parameters")
    if choice.name == "separation" and not choice.effects:
        raise DynidentError("name the effects that are to be separated", pointer="/criterion/effects")
