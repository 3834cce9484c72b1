"""Turn a request for a virtual robot into the simulation of one robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

from dynident.effects import LINKS, EffectChoice, get_effect
from dynident.effects.effect_columns import find_joints
from dynident.errors import DynidentError
from dynident.robot.model import Robot
from dynident.simulation.ground_truth import TrueEffect
from dynident.simulation.joint_control import Controller
from dynident.simulation.reference_motion import Reference
from dynident.simulation.session_runs import SimulationRequest, build_standard_parameters, check_run_labels
from dynident.simulation.typical_effects import build_typical_effect, list_drive_effects
from dynident.simulation.virtual_robot_request import ActingEffect, Session, Simulated


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
