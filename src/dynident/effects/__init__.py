"""What produces joint torque: one file a family, one catalogue of all."""

from dynident.effects.catalogue import (
    CATALOGUE,
    DEFAULT_EFFECTS,
    JOINT_FRICTION,
    LINKS,
    OFFSETS,
    UnknownEffectError,
    columns_of,
    effect_by_id,
    load_in,
    role_of,
    spec_of,
)
from dynident.effects.effect import (
    DRIVE_ROLES,
    Column,
    Effect,
    EffectChoice,
    Estimate,
    ExperimentKind,
    ParameterSpec,
    Refinement,
    Role,
    ShapeSpec,
)
from dynident.effects.operators import DAHL, STOP, TRAVEL, Operator
from dynident.effects.prediction import DRIVE_PARAMETERS, reference_size
from dynident.effects.signals import MemorySignal, RunSignal, Signals
from dynident.effects.sizes import Usual

__all__ = [
    "CATALOGUE",
    "DAHL",
    "DEFAULT_EFFECTS",
    "DRIVE_PARAMETERS",
    "DRIVE_ROLES",
    "JOINT_FRICTION",
    "LINKS",
    "OFFSETS",
    "STOP",
    "TRAVEL",
    "Column",
    "Effect",
    "EffectChoice",
    "Estimate",
    "ExperimentKind",
    "MemorySignal",
    "Operator",
    "ParameterSpec",
    "Refinement",
    "Role",
    "RunSignal",
    "ShapeSpec",
    "Signals",
    "UnknownEffectError",
    "Usual",
    "columns_of",
    "effect_by_id",
    "load_in",
    "reference_size",
    "role_of",
    "spec_of",
]
