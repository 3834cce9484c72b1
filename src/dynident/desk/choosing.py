"""Effects from whatever says which: texts, choices, and what a diagnosis found."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

from dynident.diagnosis import Diagnosis, RankedEffect
from dynident.effects import EffectChoice
from dynident.effects.written import written_effects
from dynident.errors import DynidentError
from dynident.identification.shapes.shapes import check_choices
from dynident.robot import Robot

_TITLE = "Nothing to add"


@runtime_checkable
class Diagnosed(Protocol):
    """Something with a diagnosis in it."""

    @property
    def diagnosis(self) -> Diagnosis:
        """What the library found."""
        ...


Addition = Diagnosed | Diagnosis | RankedEffect | EffectChoice | str
"""What can be added to a model."""


def named_effects(given: str | EffectChoice | Iterable[str | EffectChoice]) -> tuple[EffectChoice, ...]:
    """Effects of choices and texts: "default", "stribeck@joint2", "stribeck@joint1+joint2:vs=0.05".

    Raises
    ------
    DynidentError
        For a text that cannot be read.
    """
    items = [given] if isinstance(given, (str, EffectChoice)) else given
    return tuple(
        choice for item in items for choice in ((item,) if isinstance(item, EffectChoice) else written_effects([item]))
    )


def checked_effects(choices: tuple[EffectChoice, ...], robot: Robot) -> tuple[EffectChoice, ...]:
    """The same choices; `DynidentError` where there is no such effect or joint, or a shape constant is lacking."""
    check_choices(choices, robot)
    return choices


def added_effects(what: Iterable[Addition], robot: Robot) -> tuple[EffectChoice, ...]:
    """What is to be added, in its order.

    Raises
    ------
    DynidentError
        Where that is nothing, or does not fit the robot.
    """
    found: list[EffectChoice] = []
    empty = ""
    for item in what:
        if isinstance(item, (str, EffectChoice)):
            found += named_effects(item)
        elif isinstance(item, RankedEffect):
            found.append(item.choice)
        elif isinstance(item, (Diagnosis, Diagnosed)):
            diagnosis = item if isinstance(item, Diagnosis) else item.diagnosis
            found += diagnosis.recommended
            empty = "" if diagnosis.recommended else f"the diagnosis recommends nothing to add: {diagnosis.summary}"
        else:
            raise DynidentError(f"{item!r} is no diagnosis and no effect; an effect is written stribeck@joint2")
    if not found:
        detail = empty or 'say what to add: a diagnosis, or effects such as "stribeck@joint2"'
        raise DynidentError(detail, title=_TITLE)
    return checked_effects(tuple(found), robot)
