"""What produces joint torque: one file a family, one catalogue of all."""

from dynident.effects.catalogue import CATALOGUE, DEFAULT_EFFECTS, UnknownEffectError, columns_of, effect_by_id
from dynident.effects.effect import Column, Effect, EffectChoice, Estimate, ParameterSpec, Refinement, ShapeSpec
from dynident.effects.prediction import DRIVE_PARAMETERS, reference_size
from dynident.effects.signals import MemorySignal, RunSignal, Signals

__all__ = [
    "CATALOGUE",
    "DEFAULT_EFFECTS",
    "DRIVE_PARAMETERS",
    "Column",
    "Effect",
    "EffectChoice",
    "Estimate",
    "MemorySignal",
    "ParameterSpec",
    "Refinement",
    "RunSignal",
    "ShapeSpec",
    "Signals",
    "UnknownEffectError",
    "columns_of",
    "effect_by_id",
    "reference_size",
]
