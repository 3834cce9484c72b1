"""Virtual robots between the contract and the science."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from dynident.effects import EffectChoice, effect_by_id
from dynident.effects.catalogue import joints_of
from dynident.errors import DynidentError
from dynident.robot import Robot
from dynident.simulation import (
    Controller,
    Measurement,
    Reference,
    Sensors,
    SimulationRequest,
    TrueEffect,
    Warming,
    standard_parameters,
    typical_drive,
    typical_effect,
)
from dynident_service.adapters.answers import shown
from dynident_service.models import simulations as wire

RATE_OF_SAMPLES = 1000.0


def request_of(asked: wire.SimulationRequest, robot: Robot, reference: Reference, rate: float) -> SimulationRequest:
    """Take a simulation off the wire; `DynidentError` where it does not fit the robot."""
    named = standard_parameters(robot, asked.parameters) if asked.parameters else None
    effects = true_effects(asked.effects, robot)
    stated = () if named is None else named.effects
    taken = {(one.effect, one.joint) for one in stated}
    return SimulationRequest(
        reference=reference,
        effects=(*stated, *(one for one in effects if (one.effect, one.joint) not in taken)),
        inertias=None if named is None else named.inertias,
        sensors=sensors_of(asked.noise, rate),
        controller=Controller(asked.feed_forward),
        seed=asked.seed,
        runs=asked.runs,
        pause=asked.pause,
        warming=None if asked.warming is None else Warming(**asked.warming.model_dump()),
    )


def true_effects(asked: Sequence[wire.TrueEffect], robot: Robot) -> tuple[TrueEffect, ...]:
    """Take the effects of a virtual robot off the wire; the links need not be named, they are always there."""
    found: list[TrueEffect] = []
    for index, one in enumerate(asked):
        if one.effect == "rigid_body" and not one.parameters:
            continue
        pointer = f"/effects/{index}"
        joints = _joints(one, robot, pointer)
        try:
            found += [_true_effect(one, robot, joint) for joint in joints]
        except DynidentError as error:
            error.pointer = f"{pointer}{error.pointer}"
            raise
    return tuple(found)


def reference_of(samples: wire.Samples) -> Reference:
    """Take a trajectory off the wire; derivatives that are not given are those of a spline through q."""
    t, q = np.array(samples.t, dtype=np.float64), _matrix(samples.q, "q")
    if samples.dq is not None and samples.ddq is not None:
        return Reference(t, q, _matrix(samples.dq, "dq"), _matrix(samples.ddq, "ddq"))
    if len(t) != len(q) or not np.all(np.diff(t) > 0) or len(t) < 4:
        detail = "t has to increase, with one row of q for each, four at least, for dq and ddq to follow from q"
        raise DynidentError(detail, pointer="/trajectory/t", title="Unusable trajectory")
    spline = CubicSpline(t, q)
    dq = spline(t, 1) if samples.dq is None else _matrix(samples.dq, "dq")
    return Reference(t, q, dq, spline(t, 2) if samples.ddq is None else _matrix(samples.ddq, "ddq"))


def sensors_of(asked: wire.Noise, rate: float) -> Sensors:
    """Take the sensors off the wire."""
    absolute = asked.torque_noise_absolute
    return Sensors(
        sampling_rate=rate,
        encoder_counts=asked.encoder_counts,
        torque_noise=asked.torque_noise,
        torque_noise_absolute=None if absolute is None else tuple(absolute),
        jitter=asked.jitter,
        current=asked.current,
    )


def describe_simulation(found: Measurement, rate: float) -> wire.SimulationResult:
    """Describe a virtual robot's measurement for the wire."""
    return shown(wire.SimulationResult, found, sampling_rate=rate)


def _joints(asked: wire.TrueEffect, robot: Robot, pointer: str) -> Iterable[str]:
    choice = EffectChoice(asked.effect, tuple(asked.joints))
    indices = joints_of(choice, robot, pointer)
    if effect_by_id(asked.effect).scope == "robot":
        return ("",)
    return [robot.tree.joint_names[index] for index in indices]


def _true_effect(asked: wire.TrueEffect, robot: Robot, joint: str) -> TrueEffect:
    shape, runs = tuple(sorted(asked.shape_parameters.items())), tuple(asked.runs)
    if asked.parameters:
        return TrueEffect(asked.effect, joint, tuple(sorted(asked.parameters.items())), shape, runs)
    for one in typical_drive(robot):
        if (one.effect, one.joint) == (asked.effect, joint):
            return replace(one, runs=runs)
    typical = typical_effect(robot, asked.effect, joint)
    completed = tuple(sorted({**dict(typical.shape), **asked.shape_parameters}.items()))
    return TrueEffect(typical.effect, typical.joint, typical.values, completed, runs)


def _matrix(rows: list[list[float]], name: str) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    if len({len(row) for row in rows}) != 1:
        detail = f"the rows of {name} have different lengths; each has a value for every joint"
        raise DynidentError(detail, pointer=f"/trajectory/{name}", title="Unusable trajectory")
    return np.array(rows, dtype=np.float64)
