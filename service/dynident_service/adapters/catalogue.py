"""The catalogue of effects as a view of the contract."""

from __future__ import annotations

from dynident.effects import CATALOGUE, Effect
from dynident_service.adapters.answers import shown
from dynident_service.models import effects as wire


def catalogue() -> wire.Catalogue:
    """Return the view of all effects."""
    return wire.Catalogue(items=[_effect(effect) for effect in CATALOGUE.values()])


def _effect(effect: Effect) -> wire.EffectView:
    parameters = [
        shown(wire.EffectParameter, parameter, prismatic_unit=parameter.unit_on("prismatic"))
        for parameter in effect.parameters
    ]
    shapes = [
        shown(wire.ShapeParameter, shape, words=[wire.ShapeWord(value=value, word=word) for value, word in shape.words])
        for shape in effect.shapes
    ]
    return shown(wire.EffectView, effect, parameters=parameters, shape_parameters=shapes)
