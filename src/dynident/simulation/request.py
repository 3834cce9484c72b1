"""Everything that one simulation needs, in one value, and the standard parameters by their names."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field

from dynident.errors import DynidentError
from dynident.progress import Progress, part, silent
from dynident.robot.model import INERTIAL_NAMES, FloatArray, Robot
from dynident.simulation.control import Controller
from dynident.simulation.measurement import Measurement
from dynident.simulation.reference import Reference
from dynident.simulation.sensors import Sensors
from dynident.simulation.truth import TrueEffect, true_inertias
from dynident.simulation.virtual_robot import VirtualRobot

_NUMBERED = re.compile(r"^([A-Z][A-Za-z]*?)(\d+)$")
_FRICTION = {"Ia": "rotor_inertia", "Fc": "coulomb", "Fv": "viscous"}


@dataclass(frozen=True, eq=False)
class SimulationRequest:
    """A virtual robot, the motion it makes and the sensors it is measured with.

    `inertias` (n, 10) None: those of the robot's description.
    """

    reference: Reference
    effects: tuple[TrueEffect, ...] = ()
    inertias: FloatArray | None = None
    sensors: Sensors = field(default_factory=Sensors)
    controller: Controller = field(default_factory=Controller)
    seed: int = 0


@dataclass(frozen=True, eq=False)
class StandardParameters:
    """Inertial parameters (n, 10) of the links, and rotor inertia, Coulomb and viscous friction as effects."""

    inertias: FloatArray
    effects: tuple[TrueEffect, ...]


def simulate(robot: Robot, request: SimulationRequest, progress: Progress = silent) -> Measurement:
    """Build the virtual robot of a request and measure it.

    Raises
    ------
    DynidentError
        Where the request does not fit the robot, or the robot cannot follow the trajectory.
    """
    progress(0.0, "building the equation of motion")
    virtual = VirtualRobot(robot, request.effects, inertias=request.inertias, controller=request.controller)
    return virtual.measure(request.reference, request.sensors, seed=request.seed, progress=part(progress, 0.05, 1.0))


def standard_parameters(robot: Robot, values: Mapping[str, float]) -> StandardParameters:
    """Standard parameters of [12.1] by name ("ZZ2", "M3", "Ia1", "Fc1", "Fv1"), over those of the description.

    Raises
    ------
    DynidentError
        For a name that is no standard parameter of this robot, or a value that is not finite.
    """
    inertias = true_inertias(robot, None).copy()
    effects = []
    for name, value in values.items():
        pointer = f"/parameters/{name}"
        kind, joint = _split(robot, name, pointer)
        if not math.isfinite(value):
            raise DynidentError(f"{name} is {value}; expected a finite number", pointer=pointer)
        if kind in _FRICTION:
            effects.append(TrueEffect(_FRICTION[kind], robot.joint_names[joint], ((kind, float(value)),)))
        else:
            inertias[joint, INERTIAL_NAMES.index(kind)] = value
    return StandardParameters(inertias, tuple(effects))


def _split(robot: Robot, name: str, pointer: str) -> tuple[str, int]:
    matched = _NUMBERED.match(name)
    if matched:
        kind, number = matched.group(1), int(matched.group(2))
        if kind in (*INERTIAL_NAMES, *_FRICTION) and 1 <= number <= robot.n:
            return kind, number - 1
    raise DynidentError(
        f"there is no standard parameter {name!r}; they are {', '.join((*INERTIAL_NAMES, *_FRICTION))}, each followed "
        f"by the number of a joint from 1 to {robot.n}",
        pointer=pointer,
        title="Unknown parameter",
    )
