"""Chosen effects between the contract and the science."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.effects import EffectChoice
from dynident_service.models import common


def choice_of(asked: common.EffectChoice) -> EffectChoice:
    """Take a chosen effect off the wire."""
    shape = tuple(sorted(asked.shape_parameters.items()))
    return EffectChoice(asked.effect, tuple(asked.joints), shape, tuple(asked.runs))


def choices_of(asked: Iterable[common.EffectChoice]) -> tuple[EffectChoice, ...]:
    """Take chosen effects off the wire."""
    return tuple(choice_of(one) for one in asked)


def show_choice(choice: EffectChoice) -> common.EffectChoice:
    """Show a chosen effect."""
    return common.EffectChoice(
        effect=choice.effect,
        joints=list(choice.joints),
        shape_parameters=dict(choice.shape),
        runs=list(choice.runs),
    )
