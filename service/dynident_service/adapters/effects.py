"""Conversion of chosen effects between the contract and the library."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.effects import EffectChoice
from dynident_service.models import common


def from_wire_choice(wire_choice: common.EffectChoice) -> EffectChoice:
    """Convert a chosen effect of a body."""
    # Sorted, so that the same constants in another order are the same choice.
    shape = tuple(sorted(wire_choice.shape_parameters.items()))
    return EffectChoice(wire_choice.effect, tuple(wire_choice.joints), shape, tuple(wire_choice.runs))


def from_wire_choices(wire_choices: Iterable[common.EffectChoice]) -> tuple[EffectChoice, ...]:
    """Convert the chosen effects of a body."""
    return tuple(from_wire_choice(wire_choice) for wire_choice in wire_choices)


def show_choice(choice: EffectChoice) -> common.EffectChoice:
    """Build the view of a chosen effect."""
    return common.EffectChoice(
        effect=choice.effect,
        joints=list(choice.joints),
        shape_parameters=dict(choice.shape),
        runs=list(choice.runs),
    )
