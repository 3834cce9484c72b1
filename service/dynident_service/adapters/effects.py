"""The catalogue of effects between the contract and the science."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.effects import CATALOGUE, Effect, EffectChoice
from dynident_service.models import common
from dynident_service.models import effects as wire


def catalogue() -> wire.Catalogue:
    """Show all effects."""
    return wire.Catalogue(items=[_effect(effect) for effect in CATALOGUE.values()])


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


def _effect(effect: Effect) -> wire.EffectView:
    return wire.EffectView(
        id=effect.id,
        title=effect.title,
        formula=effect.formula,
        parameters=[
            wire.EffectParameter(
                name=one.name,
                unit=one.unit,
                prismatic_unit=one.unit_on("prismatic"),
                description=one.description,
            )
            for one in effect.parameters
        ],
        shape_parameters=[
            wire.ShapeParameter(
                name=one.name,
                unit=one.unit,
                description=one.description,
                default=one.default,
                words=[wire.ShapeWord(value=value, word=word) for value, word in one.words],
            )
            for one in effect.shapes
        ],
        signature=effect.signature,
        sources=list(effect.sources),
        confused_with=list(effect.confused_with),
        scope=effect.scope,
    )
