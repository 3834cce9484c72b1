"""Conversion of everything that names effects (texts, choices, diagnoses) to choices of effects."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Protocol, runtime_checkable

from dynident.api.argument_checks import require
from dynident.diagnosis import Diagnosis, RankedEffect
from dynident.effects import EffectChoice
from dynident.effects.text_format import parse_effects
from dynident.errors import DynidentError
from dynident.identification.shape_search import check_choices
from dynident.robot import Robot

_TITLE = "Nothing to add"


@runtime_checkable
class HasDiagnosis(Protocol):
    """Something that has a diagnosis."""

    @property
    def diagnosis(self) -> Diagnosis:
        """The diagnosis as the library gives it."""
        ...


Addition = HasDiagnosis | Diagnosis | RankedEffect | EffectChoice | str
"""What can be added to a model."""


def resolve_effects(effects: str | EffectChoice | Iterable[str | EffectChoice]) -> tuple[EffectChoice, ...]:
    """Return the effects of choices and texts: "default", "stribeck@joint2", "stribeck@joint1+joint2:vs=0.05".

    Parameters
    ----------
    effects : str, EffectChoice, or several of them
        Choices as they are, and texts such as "stribeck@joint2".

    Returns
    -------
    tuple of EffectChoice
        In their order; a text may stand for several.

    Raises
    ------
    DynidentError
        For a text that cannot be read.
    """
    # A text is iterable itself: without this test its letters would be taken for effects.
    items = [effects] if isinstance(effects, (str, EffectChoice)) else effects
    remedy = 'give texts such as "stribeck@joint2", or dy.EffectChoice(…)'
    require(isinstance(items, Iterable) and not isinstance(items, Mapping), effects, "effects", remedy)
    items = list(items)
    for item in items:
        require(isinstance(item, (str, EffectChoice)), item, "an effect", remedy)
    return tuple(
        choice for item in items for choice in ((item,) if isinstance(item, EffectChoice) else parse_effects([item]))
    )


def check_effects(choices: tuple[EffectChoice, ...], robot: Robot) -> tuple[EffectChoice, ...]:
    """Check that a robot can have some effects, and return them.

    Parameters
    ----------
    choices : tuple of EffectChoice
        Effects with their joints and shape constants.
    robot : Robot
        The robot that they shall act on.

    Returns
    -------
    tuple of EffectChoice
        The same.

    Raises
    ------
    DynidentError
        Where there is no such effect or joint, or a shape constant is lacking.
    """
    # Refused here and not minutes later, when the model is built.
    check_choices(choices, robot)
    return choices


def collect_added_effects(additions: Iterable[Addition], robot: Robot) -> tuple[EffectChoice, ...]:
    """Return the effects to be added to a model.

    Parameters
    ----------
    additions : iterable of diagnoses, ranked effects, effect choices and texts
        Of a diagnosis all effects that it recommends.
    robot : Robot
        The robot that they shall act on.

    Returns
    -------
    tuple of EffectChoice
        In their order.

    Raises
    ------
    DynidentError
        Where nothing would be added, or an effect does not fit the robot.
    """
    choices: list[EffectChoice] = []
    reason = ""
    for item in additions:
        if isinstance(item, (str, EffectChoice)):
            choices += resolve_effects(item)
        elif isinstance(item, RankedEffect):
            choices.append(item.choice)
        elif isinstance(item, (Diagnosis, HasDiagnosis)):
            diagnosis = item if isinstance(item, Diagnosis) else item.diagnosis
            choices += diagnosis.recommended
            # A diagnosis without findings is no error by itself: other arguments may still name effects. Its summary is
            # the reason that is given where nothing is left to add.
            reason = "" if diagnosis.recommended else f"the diagnosis recommends nothing to add: {diagnosis.summary}"
        else:
            raise DynidentError(f"{item!r} is neither a diagnosis nor an effect; write an effect as stribeck@joint2")
    if not choices:
        detail = reason or 'no effect to add is given: give a diagnosis, or effects such as "stribeck@joint2"'
        raise DynidentError(detail, title=_TITLE)
    return check_effects(tuple(choices), robot)
