"""The catalogue of effects as a view of the contract."""

from __future__ import annotations

from dynident.effects import CATALOGUE, Effect
from dynident_service.adapters.serialise import to_view
from dynident_service.models import effects as wire


def show_catalogue() -> wire.Catalogue:
    """Return the view of all effects."""
    return wire.Catalogue(items=[_show_effect(effect) for effect in CATALOGUE.values()])


def _show_effect(effect: Effect) -> wire.EffectView:
    parameters = [
        to_view(wire.EffectParameter, parameter, prismatic_unit=parameter.get_unit("prismatic"))
        for parameter in effect.parameters
    ]
    shapes = [
        to_view(
            wire.ShapeParameter, shape, words=[wire.ShapeWord(value=value, word=word) for value, word in shape.words]
        )
        for shape in effect.shapes
    ]
    return to_view(wire.EffectView, effect, parameters=parameters, shape_parameters=shapes)
