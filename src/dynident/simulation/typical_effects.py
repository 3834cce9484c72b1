"""Typical sizes of effects on real arms, for virtual robots of which only a description is known.

An effect without a known usual size gets parameters that give a chosen torque.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import DEFAULT_EFFECTS, EffectChoice, ReferenceParameters, build_columns, get_effect
from dynident.effects.usual_sizes import get_largest_torque
from dynident.errors import DynidentError
from dynident.robot.model import Robot
from dynident.simulation.ground_truth import TrueEffect
from dynident.simulation.signals import SensorSignals

_STATES = 200


def size_parameters(robot: Robot, effect: str, joint: str, torque: FloatArray) -> dict[str, float]:
    """Return parameters of an effect with which each of them contributes about the torque (n,) on some joint.

    The largest over the joints of rms torque over random states, relative to `torque`, is then 1 for each parameter.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    effect : str
        Id of the effect in the catalogue.
    joint : str
        Name of the joint; "" for the whole robot.
    torque : (n,)
        Torque that is wanted on each joint, N m or N.

    Returns
    -------
    dict of str to float
        Value of each parameter by its name.

    Raises
    ------
    DynidentError
        Where the effect gives no torque in any of the states.
    """
    signals = SensorSignals(robot)
    columns = build_columns([EffectChoice(effect, (joint,) if joint else ())], signals)
    stacked = ca.densify(ca.horzcat(*(column.torque for column in columns)))
    # Ranges of a brisk motion of an arm. The seed is fixed, so that sizes are the same in every call.
    rng, n = np.random.default_rng(0), robot.n
    inputs = [
        (signals.q, rng.uniform(-2, 2, (_STATES, n))),
        (signals.dq, rng.uniform(-1, 1, (_STATES, n))),
        (signals.ddq, rng.uniform(-3, 3, (_STATES, n))),
        (signals.dddq, rng.uniform(-8, 8, (_STATES, n))),
        (signals.ddddq, rng.uniform(-20, 20, (_STATES, n))),
        (signals.time, rng.uniform(0, 10, (_STATES, 1))),
        (signals.period, np.full((_STATES, 1), 1e-3)),
        (signals.temperature, rng.uniform(20, 45, (_STATES, n))),
        # Hysteresis that slides fully one way or the other has its largest torque.
        (signals.memory_symbols, rng.choice([-1.0, 1.0], (_STATES, len(signals.memory_signals)))),
        (signals.predicted.motor, torque * rng.uniform(-1, 1, (_STATES, n))),
    ]
    runs = [signals.in_runs(run) for run in signals.find_run_signals(stacked)]
    # What a column refers to, such as the Coulomb friction of its joint, is unknown here: only the links have values.
    known = ca.vertcat(signals.reference, *runs)
    stacked = ca.substitute(stacked, known, ca.vertcat(ca.SX(ca.DM(_build_reference(robot))), ca.SX.ones(len(runs), 1)))
    function = ca.Function("columns", [symbol for symbol, _ in inputs], [stacked]).map(_STATES)
    values_of_states = np.asarray(ca.DM(function(*(values.T for _, values in inputs))), dtype=np.float64)
    rows = values_of_states.reshape(n, _STATES, len(columns))
    # The largest joint counts: an effect on one joint moves torque on others, too, and none of them may exceed what was
    # asked for.
    rms = np.sqrt(np.mean(rows**2, axis=1)) / torque[:, None]
    largest = rms.max(axis=0)
    if not (np.isfinite(largest).all() and (largest > 0).all()):
        raise DynidentError(f"{effect} is no torque on {robot.name} that a size could be given to", pointer="/effect")
    return {column.parameter: float(1 / size) for column, size in zip(columns, largest, strict=True)}


def _build_reference(robot: Robot) -> FloatArray:
    links = np.zeros((robot.tree.n, 10)) if robot.inertias is None else robot.inertias
    return ReferenceParameters.from_links(links, robot.n).vector


# An effect of which nothing is known, as a share of the largest torque.
_UNKNOWN_EFFECT_SHARE = 0.02


def list_drive_effects(robot: Robot) -> tuple[TrueEffect, ...]:
    """Return rotor inertia, Coulomb and viscous friction of every joint in their usual sizes.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.

    Returns
    -------
    tuple of TrueEffect
        Joint by joint, those effects for which a usual size is known.
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
        The robot, as its description gives it.
    effect : str
        Id of the effect in the catalogue.
    joint : str
        Name of the joint; "" for the whole robot.

    Returns
    -------
    TrueEffect
        The effect, with a value for each of its parameters.

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
