"""Where an effect can be hidden such that it can be found."""

from __future__ import annotations

import numpy as np

from dynident.effects import ReferenceParameters, Signals, columns_of, effect_by_id
from dynident.effects.sizes import largest_torque, velocity_scale
from dynident.errors import DynidentError
from dynident.regressors.further_signals import FurtherSignals
from dynident.regressors.observation import Observation
from dynident.robot import Robot
from dynident.simulation import Sensors, TrueEffect, typical_effect

_STATES = 300
# Largest torque of an effect, over the noise of a single sample of the sensor, below which nobody could find it.
_WEAKEST = 2.7


def hideable(robot: Robot, effect: str, joint: str) -> list[TrueEffect]:
    """The effect, of a usual size, on every joint where it would show; or on the joint that was asked for.

    A friction that grows with the load is nothing on a joint that carries none.

    Raises
    ------
    DynidentError
        Where the effect cannot be hidden at all, or not on that joint.
    """
    described = effect_by_id(effect, "--effect")
    names = [robot.joint_names[index] for index in described.applicable(robot)]
    if joint and joint not in names:
        raise DynidentError(f"{effect} cannot sit on {joint!r}; it can on: {', '.join(names)}", pointer="--joint")
    anywhere = described.scope == "robot" or len(described.unless_named(robot)) == 1
    wanted = [joint] if joint else [""] if anywhere else names
    try:
        possible = [typical_effect(robot, effect, name) for name in wanted]
    except DynidentError as error:
        raise DynidentError(
            f"{error.detail}; an effect that every model has, or that needs more than one robot, cannot be hidden",
            pointer="--effect",
            title="Nothing to hide",
        ) from error
    return [one for one in possible if strength(robot, one) > _WEAKEST] or possible


def _while(effect: TrueEffect) -> tuple[float, float]:
    """When an effect acts, s."""
    shape = dict(effect.shape)
    return shape.get("t0", 0.0), shape.get("t1", 20.0)


def strength(robot: Robot, effect: TrueEffect) -> float:
    """The largest torque of an effect over random states, slow ones above all, over the noise of the torque sensor."""
    assert robot.inertias is not None
    signals = Signals(robot)
    columns = columns_of([effect.choice], signals)
    observation = Observation.of(robot, columns, signals)
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (_STATES, robot.n))
    dq = rng.uniform(-1.0, 1.0, (_STATES, robot.n)) ** 3 * [velocity_scale(robot, j) for j in range(robot.n)]
    entries = observation.evaluate(
        q,
        dq,
        2.0 * dq,
        reference=ReferenceParameters.of_links(robot.inertias, robot.n),
        memory=rng.choice([-1.0, 1.0], (_STATES, observation.n_memory)),
        further=FurtherSignals(
            dddq=4.0 * dq,
            ddddq=8.0 * dq,
            time=rng.uniform(*_while(effect), _STATES),
            temperature=rng.uniform(20.0, 45.0, (_STATES, robot.n)),
            runs=np.ones(len(observation.runs)),
        ),
    )
    values = dict(effect.values)
    torque = observation.torque(entries, np.array([values.get(column.parameter, 0.0) for column in columns]))
    noise = Sensors().torque_noise * np.array([largest_torque(robot, j) for j in range(robot.n)])
    return float((np.abs(torque).max(axis=0) / noise).max())
