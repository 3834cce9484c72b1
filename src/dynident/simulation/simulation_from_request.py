"""From a request and a robot to its simulated runs (`simulate`)."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import LINKS, Column, EffectChoice, get_effect, get_role
from dynident.effects.effect_columns import find_joints
from dynident.effects.predicted_torque_expressions import COULOMB, ROTOR_INERTIA, VISCOUS
from dynident.errors import DynidentError
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.robot.robot_model import INERTIAL_NAMES, Robot
from dynident.simulation.reference_motion import Reference, add_warming
from dynident.simulation.simulated_recording import SimulatedRecording, join_runs
from dynident.simulation.true_effects import TrueEffect, build_typical_effect, list_drive_effects, select_inertias
from dynident.simulation.virtual_robot import Controller, VirtualRobot
from dynident.simulation.virtual_robot_request import ActingEffect, Sensors, Session, Simulated, Warming

_TITLE = "Unusable simulation"
_NUMBERED = re.compile(r"^([A-Z][A-Za-z]*?)(\d+)$")
_FRICTION = {parameter: effect for effect, parameter in (ROTOR_INERTIA, COULOMB, VISCOUS)}


@dataclass(frozen=True, eq=False)
class SimulationRequest(Session):
    """A virtual robot, its motion, the session in which it moves and the sensors that measure it.

    Parameters
    ----------
    reference : Reference
        The motion that the robot follows in every run.
    effects : tuple of TrueEffect
        What acts besides the links. An effect that acts in some of the runs alone names them "1", "2" and so on.
    inertias : (n, 10), optional
        Inertial parameters of the links; those of the robot's description where left out.
    sensors : Sensors
        The sensors and their noise.
    controller : Controller
        The joint controller.
    runs : int
        Number of times that the motion is made; each run is a segment of the recording.
    pause : float
        Time between two runs, s.
    warming : Warming, optional
        How the joints warm up; None for the usual warming where an effect needs a temperature.
    seed : int
        Seed of the noise.

    Notes
    -----
    `warming` of the session counts where the reference prescribes no temperatures.
    """

    reference: Reference
    effects: tuple[TrueEffect, ...] = ()
    inertias: FloatArray | None = None
    sensors: Sensors = field(default_factory=Sensors)
    controller: Controller = field(default_factory=Controller)


@dataclass(frozen=True, eq=False)
class StandardParameters:
    """Standard parameters of a robot by kind: those of the links, and those of the drives as effects.

    Parameters
    ----------
    inertias : (n, 10)
        Inertial parameters of the links, a row a link.
    effects : tuple of TrueEffect
        Rotor inertia, Coulomb and viscous friction, where a value was given.
    """

    inertias: FloatArray
    effects: tuple[TrueEffect, ...]


def simulate(robot: Robot, request: SimulationRequest, progress: Progress = ignore_progress) -> SimulatedRecording:
    """Build the virtual robot of a request and measure it.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    request : SimulationRequest
        The virtual robot, its motion, session and sensors.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    SimulatedRecording
        The recording of all runs, with the motion and torque that really occurred.

    Raises
    ------
    DynidentError
        Where the request does not fit the robot, or the robot cannot follow the trajectory.
    """
    _check_effect_runs(request)
    # Of the progress a twentieth is for building; the runs share the rest evenly.
    progress(0.0, "building the equation of motion")
    virtual = VirtualRobot(robot, request.effects, inertias=request.inertias, controller=request.controller)
    recordings = []
    for k in range(request.runs):
        share = scale_progress(progress, 0.05 + 0.95 * k / request.runs, 0.05 + 0.95 * (k + 1) / request.runs)
        reference, seed = _shift_reference(request, k), _derive_seed(request.seed, k)
        recordings.append(virtual.measure(reference, request.sensors, run=str(k + 1), seed=seed, progress=share))
    return join_runs(recordings)


def _shift_reference(request: SimulationRequest, k: int) -> Reference:
    # The session's time goes on between runs, so that effects of time and temperature do.
    later = k * (request.reference.duration + request.pause)
    reference = replace(request.reference, t=request.reference.t + later)
    # Temperatures are also made without a request for them where an effect needs them, since it has no torque without.
    heated = any(get_effect(effect.effect).needs_temperature for effect in request.effects)
    if reference.temperature is None and (heated or request.warming is not None):
        return add_warming(reference, request.warming or Warming())
    return reference


def _derive_seed(seed: int, k: int) -> int:
    """Return the seed of the k-th run; the first run has that of the session, as a single run would."""
    # A seed sequence of both numbers gives independent noise; seed + k would be the noise of another session's first
    # run.
    return seed if k == 0 else int(np.random.SeedSequence([seed, k]).generate_state(1)[0])


def _check_effect_runs(request: SimulationRequest) -> None:
    for index, effect in enumerate(request.effects):
        check_run_labels(effect.effect, effect.runs, request.runs, f"/effects/{index}/runs")


def check_run_labels(effect: str, named: Sequence[str], runs: int, pointer: str) -> None:
    """Raise `DynidentError` where an effect names a run that does not exist.

    Parameters
    ----------
    effect : str
        Id of the effect, for the message.
    named : sequence of str
        Labels of the runs that the effect names.
    runs : int
        Number of runs.
    pointer : str
        Where the names stand in the request.

    Raises
    ------
    DynidentError
        For a label that is none of "1" to the number of runs.
    """
    labels = [str(k + 1) for k in range(runs)]
    unknown = [run for run in named if run not in labels]
    if unknown:
        raise DynidentError(
            f"{effect} is in run {unknown[0]}, which does not exist; there are the runs {', '.join(labels)}",
            pointer=pointer,
            title=_TITLE,
        )


def build_standard_parameters(robot: Robot, values: Mapping[str, float]) -> StandardParameters:
    """Return standard parameters of [12.1], given by name, in place of those of the description.

    Parameters
    ----------
    robot : Robot
        The robot, whose description has to give inertial parameters.
    values : mapping of str to float
        By names such as "ZZ2", "M3", "Ia1", "Fc1", "Fv1".

    Returns
    -------
    StandardParameters
        All inertial parameters, with the given values in place, and the given parameters of the drives.

    Raises
    ------
    DynidentError
        For a name that is no standard parameter of this robot, or a value that is not finite.
    """
    # A copy: the array belongs to the robot, which others use, too.
    inertias = select_inertias(robot, None).copy()
    effects = []
    for name, value in values.items():
        pointer = f"/parameters/{name}"
        kind, joint = _split_name(robot, name, pointer)
        if not math.isfinite(value):
            raise DynidentError(f"{name} is {value}; expected a finite number", pointer=pointer)
        if kind in _FRICTION:
            effects.append(TrueEffect(_FRICTION[kind], robot.joint_names[joint], ((kind, float(value)),)))
        else:
            inertias[joint, INERTIAL_NAMES.index(kind)] = value
    return StandardParameters(inertias, tuple(effects))


def compute_true_parameters(robot: Robot, request: SimulationRequest, columns: Sequence[Column]) -> FloatArray:
    """Return the values that the parameters of columns have in a virtual robot.

    Parameters
    ----------
    robot : Robot
        The robot, as its description gives it.
    request : SimulationRequest
        The virtual robot.
    columns : sequence of Column
        Columns of a model of it.

    Returns
    -------
    (c,) array
        Standard parameters in the columns' order; 0 for effects that the virtual robot does not have, NaN where it has
        the effect with other shape constants or in other runs alone.
    """
    inertias, joints = select_inertias(robot, request.inertias), robot.tree.joint_names
    return np.array(
        [
            inertias[joints.index(column.link), INERTIAL_NAMES.index(column.parameter)]
            if get_role(column) == "link"
            else _find_true_value(request.effects, column)
            for column in columns
        ]
    )


def _find_true_value(effects: Sequence[TrueEffect], column: Column) -> float:
    same = [effect for effect in effects if (effect.effect, effect.joint) == (column.effect, column.link)]
    alike = [effect for effect in same if _has_shape(effect, column)]
    own = [effect for effect in alike if set(effect.runs) == set(column.runs)]
    # An effect without runs acts in those of every column.
    fitting = own or [effect for effect in alike if not effect.runs]
    if same and not fitting:
        return math.nan
    return sum(dict(effect.values).get(column.parameter, 0.0) for effect in fitting)


def _has_shape(effect: TrueEffect, column: Column) -> bool:
    own = get_effect(effect.effect).shape_with_defaults(dict(effect.shape))
    # Files keep all digits, but a value that somebody typed need not have them.
    return all(math.isclose(own[name], value, rel_tol=1e-6) for name, value in column.shape if name in own)


def _split_name(robot: Robot, name: str, pointer: str) -> tuple[str, int]:
    """Split a name such as "ZZ2" into parameter and joint index."""
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


def build_simulation_request(
    requested: Simulated, robot: Robot, reference: Reference, rate: float
) -> SimulationRequest:
    """Return the simulation of a robot along a trajectory.

    Parameters
    ----------
    requested : Simulated
        The request, which knows neither the robot nor the motion.
    robot : Robot
        The robot, as its description gives it.
    reference : Reference
        The motion that the virtual robot follows.
    rate : float
        Sampling rate of the trajectory, Hz, which the sensors have where the request names none.

    Returns
    -------
    SimulationRequest
        The simulation, with the size of every effect and the parameters of the links.

    Raises
    ------
    DynidentError
        Where the request does not fit the robot.
    """
    acting = resolve_true_effects(requested.effects, robot)
    named = build_standard_parameters(robot, requested.parameters) if requested.parameters else None
    return SimulationRequest(
        reference=reference,
        effects=acting if named is None else replace_usual_effects(acting, named.effects),
        inertias=None if named is None else named.inertias,
        sensors=replace(requested.noise, sampling_rate=requested.sampling_rate or rate),
        controller=Controller(requested.feed_forward),
        **{session.name: getattr(requested, session.name) for session in fields(Session)},
    )


def check_acting_effects(requested: Simulated, robot: Robot) -> None:
    """Raise `DynidentError` where the requested effects do not fit the robot or the runs.

    Parameters
    ----------
    requested : Simulated
        The request with its effects and its number of runs.
    robot : Robot
        The robot, as its description gives it.

    Raises
    ------
    DynidentError
        For an effect, joint, shape constant or run that does not exist, or an effect without a size.
    """
    resolve_true_effects(requested.effects, robot)
    for index, acting in enumerate(requested.effects):
        check_run_labels(acting.effect, acting.runs, requested.runs, f"/effects/{index}/runs")


def resolve_true_effects(acting_effects: Sequence[ActingEffect], robot: Robot) -> tuple[TrueEffect, ...]:
    """Return the requested effects with their sizes, joint by joint.

    The links need not be named; they are always present.

    Parameters
    ----------
    acting_effects : sequence of ActingEffect
        The effects as they are requested, each for any number of joints.
    robot : Robot
        The robot, as its description gives it.

    Returns
    -------
    tuple of TrueEffect
        One effect for each joint, with values for its parameters.

    Raises
    ------
    DynidentError
        For an unknown effect, joint or shape constant, or an effect that has neither a usual size nor parameters.
    """
    effects: list[TrueEffect] = []
    for index, acting in enumerate(acting_effects):
        # The links take part through their inertial parameters in any case.
        if acting.effect == LINKS.effect and not acting.parameters:
            continue
        pointer = f"/effects/{index}"
        try:
            effects += [_resolve_true_effect(acting, robot, joint) for joint in _list_joints(acting, robot)]
        except DynidentError as error:
            # What raised the error knows only one effect; the user needs its place in the list.
            error.pointer = f"{pointer}{error.pointer}"
            raise
    return tuple(effects)


def replace_usual_effects(usual: Sequence[TrueEffect], stated: Sequence[TrueEffect]) -> tuple[TrueEffect, ...]:
    """Return the stated effects, followed by those usual ones that none of them replaces.

    Parameters
    ----------
    usual, stated : sequence of TrueEffect
        Effects of usual size, and those whose values the user states.

    Returns
    -------
    tuple of TrueEffect
        All stated effects, then the remaining usual ones.
    """
    # An effect is replaced on the joint where it is stated, and keeps its usual size on all others.
    occupied = {(effect.effect, effect.joint) for effect in stated}
    return (*stated, *(effect for effect in usual if (effect.effect, effect.joint) not in occupied))


def _list_joints(acting: ActingEffect, robot: Robot) -> Iterator[str]:
    indices = find_joints(EffectChoice(acting.effect, acting.joints), robot)
    if get_effect(acting.effect).scope == "robot":
        yield ""
        return
    for index in indices:
        yield robot.tree.joint_names[index]


def _resolve_true_effect(acting: ActingEffect, robot: Robot, joint: str) -> TrueEffect:
    """Return one effect on one joint, of its requested or its typical size."""
    shape = tuple(sorted(acting.shape_parameters.items()))
    # Three sources, the most specific first: the requested values, the usual size of a drive effect, the typical size
    # of any other effect.
    if acting.parameters:
        return TrueEffect(acting.effect, joint, tuple(sorted(acting.parameters.items())), shape, acting.runs)
    for drive_effect in list_drive_effects(robot):
        if (drive_effect.effect, drive_effect.joint) == (acting.effect, joint):
            return replace(drive_effect, runs=acting.runs)
    typical = build_typical_effect(robot, acting.effect, joint)
    # Requested shape constants replace the typical ones of the same name.
    completed = tuple(sorted({**dict(typical.shape), **dict(shape)}.items()))
    return TrueEffect(typical.effect, typical.joint, typical.values, completed, acting.runs)
