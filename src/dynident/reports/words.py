"""Effects and joints in words."""

from __future__ import annotations

from dynident.effects import CATALOGUE, EffectChoice, effect_by_id
from dynident.robot import Robot


def place_text(joints: tuple[str, ...], robot: Robot) -> str:
    """Joints in words."""
    if len(joints) == robot.n > 1:
        return "all joints"
    return ", ".join(joints) or "the whole robot"


def shape_text(choice: EffectChoice) -> str:
    """Shape constants with their units."""
    units = {spec.name: spec.unit for spec in effect_by_id(choice.effect).shapes}
    return ", ".join(
        f"{name} = {value:.3g}{'' if units[name] == '-' else ' ' + units[name]}" for name, value in choice.shape
    )


def title_of(identifier: str) -> str:
    """An effect's title; its id in words where the catalogue does not hold it.

    What is equivalent to a finding need not be in the catalogue: some effects are the same function.
    """
    return CATALOGUE[identifier].title if identifier in CATALOGUE else identifier.replace("_", " ")
