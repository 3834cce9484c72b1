"""Sizes that effects have on real arms, for virtual robots of whom nothing but a description is known."""

from __future__ import annotations

import numpy as np

from dynident.effects import DEFAULT_EFFECTS, effect_by_id
from dynident.effects.sizes import largest_torque
from dynident.errors import DynidentError
from dynident.robot.model import Robot
from dynident.simulation.sizing import sized
from dynident.simulation.truth import TrueEffect

# An effect of which nothing is known, as a share of the largest torque.
_UNKNOWN = 0.02


def typical_drive(robot: Robot) -> tuple[TrueEffect, ...]:
    """Rotor inertia, Coulomb and viscous friction of every joint."""
    found = []
    for choice in DEFAULT_EFFECTS:
        for j, name in enumerate(robot.joint_names):
            usual = effect_by_id(choice.effect).usual(robot, j)
            if usual is not None:
                found.append(TrueEffect(choice.effect, name, tuple(usual.values.items())))
    return tuple(found)


def typical_effect(robot: Robot, effect: str, joint: str = "") -> TrueEffect:
    """One more effect, of a size as found on real arms, on a joint ("" where it belongs to the whole robot).

    Raises
    ------
    DynidentError
        For an unknown effect or joint, or an effect that nobody hides (links, rotors, Coulomb, viscous).
    """
    described = effect_by_id(effect)
    anywhere = described.scope == "robot" or described.in_some_runs
    if not anywhere and joint not in robot.joint_names:
        raise DynidentError(
            f"{effect} needs a joint; {robot.name} has: {', '.join(robot.joint_names)}", pointer="/joint"
        )
    if any(choice.effect == effect for choice in DEFAULT_EFFECTS):
        raise DynidentError(f"{effect} has no typical size", pointer="/effect")
    where = joint if described.scope == "joint" else ""
    usual = described.usual(robot, 0 if anywhere else robot.joint_names.index(joint))
    if usual is not None:
        return TrueEffect(effect, where, tuple(usual.values.items()), tuple(usual.shape.items()))
    torque = np.array([largest_torque(robot, j) for j in range(robot.n)])
    parameters = sized(robot, effect, where, _UNKNOWN * torque)
    return TrueEffect(effect, where, tuple((name, value / len(parameters)) for name, value in parameters.items()))
