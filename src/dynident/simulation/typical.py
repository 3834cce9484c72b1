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
from dynident.simulation.sizing import sized
from dynident.simulation.truth import TrueEffect, on_each_joint

# Where a description gives no effort limit, N m or N.
_EFFORT_WHERE_UNKNOWN = 50.0
_COULOMB, _VISCOUS_AT_FULL_SPEED = 0.03, 0.05
# Rotor inertia per unit of the largest torque, kg m² per N m: a geared servo drive reaches about 170 rad/s² alone.
_ROTOR = 0.006
# Torsional stiffness of a joint per unit of the largest torque, N m/rad per N m; ratio of a direct gear.
_STIFFNESS, _GEAR_RATIO = 70.0, 20.0
# An effect of which nothing is known, as a share of the largest torque.
_UNKNOWN = 0.02
_OF_EVERY_ROBOT = frozenset({"rigid_body", "rotor_inertia", "coulomb", "viscous"})


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
    if described.scope == "robot" or described.in_some_runs:
        sizes, shape = _whole_robot(robot, effect)
    elif joint in robot.joint_names:
        sizes, shape = _on_joint(robot, effect, robot.joint_names.index(joint))
    else:
        raise DynidentError(
            f"{effect} needs a joint; {robot.name} has: {', '.join(robot.joint_names)}", pointer="/joint"
        )
    if not sizes and effect in _OF_EVERY_ROBOT:
        raise DynidentError(f"{effect} has no typical size", pointer="/effect")
    if not sizes:
        torque = np.array([largest_torque(robot, j) for j in range(robot.n)])
        parameters = sized(robot, effect, joint if described.scope == "joint" else "", _UNKNOWN * torque)
        sizes = {name: value / len(parameters) for name, value in parameters.items()}
    return TrueEffect(effect, joint if described.scope == "joint" else "", tuple(sizes.items()), tuple(shape.items()))


def _whole_robot(robot: Robot, effect: str) -> tuple[dict[str, float], dict[str, float]]:
    """Parameters and shape constants."""
    # Two degrees, in a direction between the axes.
    lean = float(np.linalg.norm(robot.gravity)) * np.sin(np.radians(2.0))
    # What the strongest joint lifts at one metre with a twelfth of its torque.
    force = max(largest_torque(robot, j) for j in range(robot.n)) / 12
    mass = force / 9.81
    table: dict[str, tuple[dict[str, float], dict[str, float]]] = {
        "base_tilt": ({"gx": 0.8 * lean, "gy": -0.6 * lean}, {}),
        # A ball of 4 cm, 6 cm before the flange.
        "payload": (
            {"Mp": mass, "MZp": 0.06 * mass, "XXp": 4.2e-3 * mass, "YYp": 4.2e-3 * mass, "ZZp": 0.6e-3 * mass},
            {},
        ),
        "torque_delay": ({"delay": 8e-3}, {}),
        "external_contact": ({"fx": 0.5 * force, "fz": force, "fzh": 0.5 * force}, {"t0": 3.0, "t1": 4.5}),
        "base_vibration": ({"axc": 0.3, "ays": 0.2, "azc": 0.1, "azs": 0.3}, {"f": 7.0}),
    }
    return table.get(effect, ({}, {}))


def _on_joint(robot: Robot, effect: str, joint: int) -> tuple[dict[str, float], dict[str, float]]:
    """Parameters and shape constants."""
    torque, speed = largest_torque(robot, joint), velocity_scale(robot, joint)
    coulomb, viscous = _COULOMB * torque, _VISCOUS_AT_FULL_SPEED * torque / speed
    revolute = robot.joints[joint].kind == "revolute"
    half = speed / 2
    table: dict[str, tuple[dict[str, float], dict[str, float]]] = {
        "offset": ({"b": 0.015 * torque}, {}),
        "coulomb_asymmetric": ({"Fcp": 0.3 * _COULOMB * torque, "Fcn": 0.0}, {}),
        "viscous_asymmetric": ({"Fva": 0.3 * _VISCOUS_AT_FULL_SPEED * torque / speed}, {}),
        "stribeck": ({"Fst": 0.6 * _COULOMB * torque}, {"vs": 0.03 * speed}),
        "viscous_nonlinear": ({"Fvn": 0.06 * torque / half**2}, {"p": 2.0}),
        "load_dependent_friction": ({"cl": 0.08}, {}),
        "position_dependent_friction": ({"Fpc": 0.3 * _COULOMB * torque, "Fps": 0.2 * _COULOMB * torque}, {"k": 1.0}),
        "temperature_friction": ({"Fvt": -0.02 * viscous, "Fct": -0.01 * coulomb}, {}),
        "warm_up_friction": ({"Fvw": 0.6 * viscous, "Fcw": 0.3 * coulomb}, {"Tw": 900.0}),
        "presliding": ({"Fz": 0.8 * _COULOMB * torque, "cz": 0.0}, {"d0": 8e-3}),
        "break_away": ({"Fba": 0.6 * _COULOMB * torque}, {"db": 8e-3}),
        "backlash": (dict.fromkeys(("bl", "bi"), 2e-3 if revolute else 0.2e-3), {"w": 0.04 * torque}),
        "joint_elasticity": ({"Ce": 1 / (_STIFFNESS * torque), "Cl": 1 / (_STIFFNESS * torque)}, {}),
        "joint_spring": ({"ks": 0.03 * torque, "bs": -0.01 * torque}, {}),
        "gravity_compensator": ({"kab": 0.2 * torque, "kal": -0.1 * torque}, {"phi": 0.3, "r": 0.25}),
        "cable_force": ({"u20_": 0.01 * torque, "u11_": 0.02 * torque, "u02_": 0.01 * torque}, {}),
        "rotor_coupling": ({"NJ": _ROTOR * torque / _GEAR_RATIO}, {}),
        "drive_gain_error": ({"eps": 0.06}, {}),
        "drive_gain_saturation": ({"sat": 0.12 / torque}, {}),
        "encoder_zero_error": ({"dq0": 0.03 if revolute else 3e-3}, {}),
        "kinematic_error": ({"dx": 8e-3, "dy": -5e-3, "dz": 4e-3}, {}),
        "torque_ripple": ({"Ac": 0.012 * torque, "As": 0.009 * torque}, {"k": 20.0}),
        "transmission_coupling": (
            {"Iam": 0.2 * _ROTOR * torque, "Fvm": 0.3 * _VISCOUS_AT_FULL_SPEED * torque / speed,
             "Fcm": 0.3 * _COULOMB * torque},
            {"side": 1.0},
        ),
    }  # fmt: skip
    return table.get(effect, ({}, {}))
