"""A simulator of the robot with the identified parameters."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.effects import Column
from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.identification.estimators.simulator import true_effects
from dynident.recordings import Preprocessing, Recording, filtered_blocks
from dynident.regressors.model import Model
from dynident.robot.model import INERTIAL_NAMES, FloatArray, Robot
from dynident.simulation import Reference, VirtualRobot, on_each_joint
from dynident.simulation.truth import NEVER_NEGATIVE

_TITLE = "No motion to simulate"


@dataclass(frozen=True, eq=False)
class Simulator:
    """A virtual robot, and the base parameters (b,) that it really has.

    They are those identified but for friction and rotors below zero, which no robot has: these are zero.
    """

    robot: VirtualRobot
    values: FloatArray


@dataclass(frozen=True, eq=False)
class RecordedMotion:
    """An unbroken stretch of a recording's used samples: the filtered motion, and the torque (m, n) measured along it.

    `label` is that of its run.
    """

    reference: Reference
    tau: FloatArray
    label: str


def simulator_of(identification: Identification) -> Simulator:
    """The virtual robot whose parameters are those identified.

    Raises
    ------
    DynidentError
        Where no such robot can exist.
    """
    model, robot = identification.model, identification.model.robot
    standard = _standard(model, identification.values)
    values = model.base.grouping @ standard
    inertias, rotors = model.standard_inertia(identification.values), np.zeros(robot.n)
    for column, value in zip(model.columns, standard, strict=True):
        if column.effect == "rigid_body":
            inertias[_place(model, column)] = value
        elif column.effect == "rotor_inertia":
            rotors[robot.joint_names.index(column.link)] = value
    effects = [one for one in true_effects(model, values) if one.effect != "rotor_inertia"]
    turning = [one for one in on_each_joint(robot, "rotor_inertia", "Ia", rotors) if one.values[0][1] > 0]
    virtual = VirtualRobot(_tireless(robot), [*turning, *effects], inertias=inertias.reshape(robot.n, 10))
    return Simulator(virtual, values)


def _tireless(robot: Robot) -> Robot:
    """The robot without effort limits: the real one has made the motion, whatever they are said to be."""
    return replace(robot, joints=tuple(replace(j, limits=replace(j.limits, effort=None)) for j in robot.joints))


def _standard(model: Model, values: FloatArray) -> FloatArray:
    """Standard parameters (c,) of all columns, with these base parameters (b,) as far as signs allow.

    Of rotors and links only sums are determined, so a rotor may have come out below zero: the links take that over.
    """
    n = model.robot.n
    inertias, rotors = model.standard_inertia(values), model.reference(values)[10 * n : 11 * n]
    own = dict(zip(model.base.kept, values, strict=True))
    standard = np.zeros(len(model.columns))
    for k, column in enumerate(model.columns):
        if column.effect == "rigid_body":
            standard[k] = inertias[_place(model, column)]
        elif column.effect == "rotor_inertia":
            standard[k] = rotors[model.robot.joint_names.index(column.link)]
        else:
            standard[k] = own.get(k, 0.0)
    impossible = [
        k
        for k, c in enumerate(model.columns)
        if (c.effect, c.parameter) in NEVER_NEGATIVE and not c.runs and standard[k] < 0
    ]
    standard[impossible] = 0.0
    links = [k for k, column in enumerate(model.columns) if column.effect == "rigid_body"]
    if impossible and links:
        gap = values - model.base.grouping @ standard
        standard[links] += np.linalg.pinv(model.base.grouping[:, links], rcond=1e-9) @ gap
    return standard


def _place(model: Model, column: Column) -> int:
    return 10 * model.robot.joint_names.index(column.link) + INERTIAL_NAMES.index(column.parameter)


def recorded_motion(recording: Recording, preprocessing: Preprocessing, longest: float) -> RecordedMotion:
    """The longest unbroken stretch of used samples, cut to at most `longest` seconds.

    Raises
    ------
    DynidentError
        Where there are not two such samples.
    """
    best: list[tuple[FloatArray, ...]] = []
    run: list[tuple[FloatArray, ...]] = []
    kept, length, segment_of_best = 0, 0, 0
    for block in filtered_blocks(recording, preprocessing):
        if block.starts_segment:
            run, length = [], 0
        heat = block.temperature if block.temperature is not None else np.zeros_like(block.q)
        borders = np.flatnonzero(np.diff(block.used)) + 1
        for piece in np.split(np.arange(len(block.t)), borders):
            if not len(piece) or not block.used[piece[0]]:
                run, length = [], 0
                continue
            rows = (block.t, block.q, block.dq, block.ddq, block.tau, heat)
            run = [*run, tuple(item[piece] for item in rows)]
            length += len(piece)
            if length > kept:
                best, kept, segment_of_best = run, length, block.segment
    if kept < 2:
        raise DynidentError(
            f"{recording.name} has no unbroken stretch of samples inside its windows", pointer="/windows", title=_TITLE
        )
    t, q, dq, ddq, tau, heat = (np.concatenate([rows[k] for rows in best]) for k in range(6))
    inside = t <= t[0] + longest
    temperature = heat[inside] if recording.has_temperature else None
    reference = Reference(t[inside], q[inside], dq[inside], ddq[inside], temperature)
    return RecordedMotion(reference, tau[inside], recording.run_label(segment_of_best))
