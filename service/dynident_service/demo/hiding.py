"""The choice of a joint on which a hidden effect can be found."""

from __future__ import annotations

import numpy as np

from dynident.effects import ReferenceParameters, Signals, build_columns, get_effect
from dynident.effects.sizes import get_largest_torque, get_velocity_scale
from dynident.errors import DynidentError
from dynident.regressors.further_signals import FurtherSignals
from dynident.regressors.observation import Observation
from dynident.robot import Robot
from dynident.simulation import Sensors, TrueEffect, build_typical_effect

# Random states at which an effect's torque is computed.
_STATES = 300
# An effect whose largest torque, over the noise of one sample of the sensor, is below this cannot be found.
_MIN_SIGNAL_TO_NOISE = 2.7


def find_hideable_effects(robot: Robot, effect: str, joint: str) -> list[TrueEffect]:
    """Return an effect of a usual size on every joint where it would show, or on one joint only.

    A friction that grows with the load, for instance, is nothing on a joint that carries none.

    Parameters
    ----------
    robot : Robot
    effect : str
        The effect's id.
    joint : str
        The joint to hide it on; "" for any.

    Returns
    -------
    list of TrueEffect

    Raises
    ------
    DynidentError
        Where the effect cannot be hidden at all, or not on that joint.
    """
    effect_class = get_effect(effect, "--effect")
    names = [robot.joint_names[index] for index in effect_class.applicable(robot)]
    if joint and joint not in names:
        raise DynidentError(f"{effect} cannot sit on {joint!r}; it can on: {', '.join(names)}", pointer="--joint")
    anywhere = effect_class.scope == "robot" or len(effect_class.get_default_joints(robot)) == 1
    joint_names = [joint] if joint else [""] if anywhere else names
    try:
        possible = [build_typical_effect(robot, effect, name) for name in joint_names]
    except DynidentError as error:
        raise DynidentError(
            f"{error.detail}; an effect that every model has, or that needs more than one robot, cannot be hidden",
            pointer="--effect",
            title="Nothing to hide",
        ) from error
    # Where it shows on no joint it is hidden all the same: the demonstration then says that nobody could have seen it.
    return [
        candidate for candidate in possible if compute_signal_to_noise(robot, candidate) > _MIN_SIGNAL_TO_NOISE
    ] or possible


def _get_active_interval(effect: TrueEffect) -> tuple[float, float]:
    """Return the times between which an effect acts, s."""
    shape = dict(effect.shape)
    return shape.get("t0", 0.0), shape.get("t1", 20.0)


def compute_signal_to_noise(robot: Robot, effect: TrueEffect) -> float:
    """Return the largest torque of an effect over random states, over the noise of the torque sensor.

    Parameters
    ----------
    robot : Robot
        With inertias.
    effect : TrueEffect

    Returns
    -------
    float
    """
    assert robot.inertias is not None
    signals = Signals(robot)
    columns = build_columns([effect.choice], signals)
    observation = Observation.from_columns(robot, columns, signals)
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (_STATES, robot.n))
    # The third power makes slow states frequent: friction at low speed shows only there.
    dq = rng.uniform(-1.0, 1.0, (_STATES, robot.n)) ** 3 * [get_velocity_scale(robot, j) for j in range(robot.n)]
    entries = observation.evaluate(
        q,
        dq,
        2.0 * dq,
        reference=ReferenceParameters.from_links(robot.inertias, robot.n),
        memory=rng.choice([-1.0, 1.0], (_STATES, observation.n_memory)),
        further=FurtherSignals(
            dddq=4.0 * dq,
            ddddq=8.0 * dq,
            time=rng.uniform(*_get_active_interval(effect), _STATES),
            temperature=rng.uniform(20.0, 45.0, (_STATES, robot.n)),
            runs=np.ones(len(observation.runs)),
        ),
    )
    values = dict(effect.values)
    torque = observation.compute_torque(entries, np.array([values.get(column.parameter, 0.0) for column in columns]))
    noise = Sensors().torque_noise * np.array([get_largest_torque(robot, j) for j in range(robot.n)])
    return float((np.abs(torque).max(axis=0) / noise).max())
