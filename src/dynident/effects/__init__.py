"""Effects: the physical causes of joint torque, a module for each family, and one catalogue of all."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.effects.catalogue import (
        CATALOGUE,
        UnknownEffectError,
        get_effect,
        get_role,
        get_spec,
        is_plain_friction,
    )
    from dynident.effects.effect import (
        DRIVE_ROLES,
        Column,
        Effect,
        Estimate,
        ExperimentKind,
        ParameterSpec,
        Refinement,
        Role,
        ShapeSpec,
    )
    from dynident.effects.effect_choices import (
        ANGLE_FRICTION,
        DEFAULT_EFFECTS,
        JOINT_FRICTION,
        LINKS,
        OFFSETS,
        EffectChoice,
        choose_payload,
    )
    from dynident.effects.effect_columns import build_columns
    from dynident.effects.effect_signals import DAHL, STOP, TRAVEL, MemorySignal, Operator, RunSignal, Signals
    from dynident.effects.predicted_torque_expressions import (
        DRIVE_PARAMETERS,
        ReferenceParameters,
        count_reference_parameters,
    )
    from dynident.effects.usual_effect_sizes import UsualSize

__all__ = [
    "ANGLE_FRICTION",
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
    "ReferenceParameters",
    "Refinement",
    "Role",
    "RunSignal",
    "ShapeSpec",
    "Signals",
    "UnknownEffectError",
    "UsualSize",
    "build_columns",
    "choose_payload",
    "count_reference_parameters",
    "get_effect",
    "get_role",
    "get_spec",
    "is_plain_friction",
]

if not TYPE_CHECKING:
    # Choices of effects are declared in this package, too. Loading names lazily lets code that only reads choices
    # start without CasADi.
    __getattr__, __dir__ = make_lazy_exports(__name__)
