"""Typical sizes of effects on real arms, for virtual robots of which only a description is known."""

from __future__ import annotations

import numpy as np

from dynident.effects import DEFAULT_EFFECTS, get_effect
from dynident.effects.sizes import get_largest_torque
from dynident.errors import DynidentError
from dynident.robot.model import Robot
from dynident.simulation.sizing import size_parameters
from dynident.simulation.truth import TrueEffect

# An effect of which nothing is known, as a share of the largest torque.
_UNKNOWN_EFFECT_SHARE = 0.02


def list_drive_effects(robot: Robot) -> tuple[TrueEffect, ...]:
    """Return rotor inertia, Coulomb and viscous friction of every joint in their usual sizes.

    Parameters
    ----------
    robot : Robot

    Returns
    -------
    tuple of TrueEffect
    """
    effects = []
    for choice in DEFAULT_EFFECTS:
        for j, name in enumerate(robot.joint_names):
            usual = get_effect(choice.effect).usual(robot, j)
            if usual is not None:
                effects.append(TrueEffect(choice.effect, name, tuple(usual.values.items())))
    return tuple(effects)


def build_typical_effect(robot: Robot, effect: str, joint: str = "") -> TrueEffect:
    """Return one more effect of a size as found on real arms.

    Parameters
    ----------
    robot : Robot
    effect : str
    joint : str
        "" for the whole robot.

    Returns
    -------
    TrueEffect

    Raises
    ------
    DynidentError
        For an unknown effect or joint, or an effect without a typical size (links, rotors, Coulomb, viscous).
    """
    described = get_effect(effect)
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
    torque = np.array([get_largest_torque(robot, j) for j in range(robot.n)])
    parameters = size_parameters(robot, effect, where, _UNKNOWN_EFFECT_SHARE * torque)
    # Each parameter alone would give the torque; shared out, all of them together do about.
    return TrueEffect(effect, where, tuple((name, value / len(parameters)) for name, value in parameters.items()))
