"""What produces joint torque: one file a family, one catalogue of all."""

from dynident.effects.catalogue import CATALOGUE, DEFAULT_EFFECTS, UnknownEffectError, columns_of, effect_by_id
from dynident.effects.effect import Column, Effect, EffectChoice, ParameterSpec, ShapeSpec
from dynident.effects.signals import MemorySignal, Signals

__all__ = [
    "CATALOGUE",
    "DEFAULT_EFFECTS",
    "Column",
    "Effect",
    "EffectChoice",
    "MemorySignal",
    "ParameterSpec",
    "ShapeSpec",
    "Signals",
    "UnknownEffectError",
    "columns_of",
    "effect_by_id",
]
