"""Sizes that effects have on real arms, for virtual robots of whom nothing but a description is known.

Shares of a joint's largest torque, after the sources that the catalogue names for each effect and recordings of real
arms: not those of any particular robot.
"""

from __future__ import annotations

import numpy as np

from dynident.effects import effect_by_id
from dynident.effects.friction import velocity_scale
from dynident.errors import DynidentError
from dynident.robot.model import Robot
from dynident.simulation.truth import TrueEffect, on_each_joint

# Where a description gives no effort limit, N m or N.
_EFFORT_WHERE_UNKNOWN = 50.0
_COULOMB, _VISCOUS_AT_FULL_SPEED = 0.03, 0.05
# Rotor inertia per unit of the largest torque, kg m² per N m: a geared servo drive reaches about 170 rad/s² alone.
_ROTOR = 0.006


def largest_torque(robot: Robot, joint: int) -> float:
    """The effort limit of a joint, or an arm's usual one where none is known."""
    return robot.joints[joint].limits.effort or _EFFORT_WHERE_UNKNOWN


def typical_drive(robot: Robot) -> tuple[TrueEffect, ...]:
    """Rotor inertia, Coulomb and viscous friction of every joint."""
    torque = np.array([largest_torque(robot, j) for j in range(robot.n)])
    speed = np.array([velocity_scale(robot, j) for j in range(robot.n)])
    return (
        *on_each_joint(robot, "rotor_inertia", "Ia", _ROTOR * torque),
        *on_each_joint(robot, "coulomb", "Fc", _COULOMB * torque),
        *on_each_joint(robot, "viscous", "Fv", _VISCOUS_AT_FULL_SPEED * torque / speed),
    )


def typical_effect(robot: Robot, effect: str, joint: str = "") -> TrueEffect:
    """One more effect, of a size as found on real arms, on a joint ("" where it belongs to the whole robot).

    Raises
    ------
    DynidentError
        For an unknown effect or joint, or an effect that nobody hides (links, rotors, Coulomb, viscous).
    """
    described = effect_by_id(effect)
    sizes: dict[str, float]
    shape: dict[str, float]
    if described.scope == "robot":
        sizes, shape = _whole_robot(robot, effect), {}
    elif joint in robot.joint_names:
        sizes, shape = _on_joint(robot, effect, robot.joint_names.index(joint))
    else:
        raise DynidentError(
            f"{effect} needs a joint; {robot.name} has: {', '.join(robot.joint_names)}", pointer="/joint"
        )
    if not sizes:
        raise DynidentError(f"{effect} has no typical size", pointer="/effect")
    return TrueEffect(effect, joint if described.scope == "joint" else "", tuple(sizes.items()), tuple(shape.items()))


def _whole_robot(robot: Robot, effect: str) -> dict[str, float]:
    # Two degrees, in a direction between the axes.
    lean = float(np.linalg.norm(robot.gravity)) * np.sin(np.radians(2.0))
    return {"base_tilt": {"gx": 0.8 * lean, "gy": -0.6 * lean}}.get(effect, {})


def _on_joint(robot: Robot, effect: str, joint: int) -> tuple[dict[str, float], dict[str, float]]:
    """Parameters and shape constants."""
    torque, speed = largest_torque(robot, joint), velocity_scale(robot, joint)
    half = speed / 2
    table: dict[str, tuple[dict[str, float], dict[str, float]]] = {
        "offset": ({"b": 0.015 * torque}, {}),
        "viscous_asymmetric": ({"Fva": 0.3 * _VISCOUS_AT_FULL_SPEED * torque / speed}, {}),
        "stribeck": ({"Fst": 0.6 * _COULOMB * torque}, {"vs": 0.03 * speed}),
        "viscous_nonlinear": ({"Fvn": 0.06 * torque / half**2}, {"p": 2.0}),
        "load_dependent_friction": ({"cl": 0.08}, {}),
        "position_dependent_friction": ({"Fpc": 0.3 * _COULOMB * torque, "Fps": 0.2 * _COULOMB * torque}, {"k": 1.0}),
        "presliding": ({"Fz": 0.8 * _COULOMB * torque, "cz": 0.0}, {"d0": 8e-3}),
        "joint_spring": ({"ks": 0.03 * torque, "bs": -0.01 * torque}, {}),
        "torque_ripple": ({"Ac": 0.012 * torque, "As": 0.009 * torque}, {"k": 20.0}),
        "transmission_coupling": (
            {"Iam": 0.2 * _ROTOR * torque, "Fvm": 0.3 * _VISCOUS_AT_FULL_SPEED * torque / speed,
             "Fcm": 0.3 * _COULOMB * torque},
            {"side": 1.0},
        ),
    }  # fmt: skip
    return table.get(effect, ({}, {}))
