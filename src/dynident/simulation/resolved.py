"""From what is asked of a virtual robot to the simulation of one robot."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import fields, replace

from dynident.effects import LINKS, EffectChoice, effect_by_id
from dynident.effects.catalogue import joints_of
from dynident.errors import DynidentError
from dynident.robot.model import Robot
from dynident.simulation.control import Controller
from dynident.simulation.reference import Reference
from dynident.simulation.request import SimulationRequest, check_runs_named, standard_parameters
from dynident.simulation.stated import ActingEffect, Session, Simulated
from dynident.simulation.truth import TrueEffect
from dynident.simulation.typical import typical_drive, typical_effect


def simulation_of(asked: Simulated, robot: Robot, reference: Reference, rate: float) -> SimulationRequest:
    """The simulation of a robot along a trajectory that is sampled at `rate` Hz where nothing else is asked.

    Raises
    ------
    DynidentError
        Where what is asked does not fit the robot.
    """
    acting = true_effects(asked.effects, robot)
    named = standard_parameters(robot, asked.parameters) if asked.parameters else None
    return SimulationRequest(
        reference=reference,
        effects=acting if named is None else beside(acting, named.effects),
        inertias=None if named is None else named.inertias,
        sensors=replace(asked.noise, sampling_rate=asked.sampling_rate or rate),
        controller=Controller(asked.feed_forward),
        **{one.name: getattr(asked, one.name) for one in fields(Session)},
    )


def check_acting(asked: Simulated, robot: Robot) -> None:
    """Raise `DynidentError` where the effects asked for do not fit the robot or the runs."""
    true_effects(asked.effects, robot)
    for index, one in enumerate(asked.effects):
        check_runs_named(one.effect, one.runs, asked.runs, f"/effects/{index}/runs")


def true_effects(asked: Sequence[ActingEffect], robot: Robot) -> tuple[TrueEffect, ...]:
    """The effects with their sizes, joint by joint; the links need not be named, they are always there.

    Raises
    ------
    DynidentError
        For an unknown effect, joint or shape constant, or an effect without a usual size and no parameters.
    """
    found: list[TrueEffect] = []
    for index, one in enumerate(asked):
        if one.effect == LINKS.effect and not one.parameters:
            continue
        pointer = f"/effects/{index}"
        try:
            found += [_true_effect(one, robot, joint) for joint in _joints(one, robot)]
        except DynidentError as error:
            error.pointer = f"{pointer}{error.pointer}"
            raise
    return tuple(found)


def beside(usual: Sequence[TrueEffect], stated: Sequence[TrueEffect]) -> tuple[TrueEffect, ...]:
    """The stated effects, and the usual ones where none of these stands in their place."""
    taken = {(one.effect, one.joint) for one in stated}
    return (*stated, *(one for one in usual if (one.effect, one.joint) not in taken))


def _joints(asked: ActingEffect, robot: Robot) -> Iterator[str]:
    indices = joints_of(EffectChoice(asked.effect, asked.joints), robot)
    if effect_by_id(asked.effect).scope == "robot":
        yield ""
        return
    for index in indices:
        yield robot.tree.joint_names[index]


def _true_effect(asked: ActingEffect, robot: Robot, joint: str) -> TrueEffect:
    shape = tuple(sorted(asked.shape_parameters.items()))
    if asked.parameters:
        return TrueEffect(asked.effect, joint, tuple(sorted(asked.parameters.items())), shape, asked.runs)
    for one in typical_drive(robot):
        if (one.effect, one.joint) == (asked.effect, joint):
            return replace(one, runs=asked.runs)
    typical = typical_effect(robot, asked.effect, joint)
    completed = tuple(sorted({**dict(typical.shape), **dict(shape)}.items()))
    return TrueEffect(typical.effect, typical.joint, typical.values, completed, asked.runs)
