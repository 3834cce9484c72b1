"""How much the friction of each joint differs between two days, whether or not that is a finding."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from dynident.arrays import FloatArray
from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.result import FrictionDifference
from dynident.effects import Column, EffectChoice
from dynident.effects.catalogue import role_of
from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.identification.study.extending import extend_at_once
from dynident.recordings import Recording
from dynident.robot.model import Joint


def with_friction_differences(
    grown: Identification, since: tuple[str, ...], recordings: Sequence[Recording]
) -> Identification:
    """The model in which the friction of every joint may differ in the later runs.

    Friction is hardly ever the same on two days. What was too little of that to be a finding is made up for by the
    values of what was found, and their intervals do not say so, where it has no parameters of its own.
    """
    lacking = [EffectChoice(effect, joints, (), since) for effect, joints in _lacking(grown, since).items()]
    if not lacking:
        return grown
    with suppress(DynidentError):
        return extend_at_once(grown, lacking, recordings)
    # What the motions do not determine of one joint is no reason to say nothing of the others.
    for choice in lacking:
        for joint in choice.joints:
            with suppress(DynidentError):
                grown = extend_at_once(grown, [replace(choice, joints=(joint,))], recordings)
    return grown


def friction_since(
    grown: Identification, since: tuple[str, ...], later: Sequence[Comparison]
) -> tuple[FrictionDifference, ...]:
    """By how much the friction of every joint that moves is larger in the later runs.

    Coulomb and viscous friction make up for each other: what they are together at the speed that the joint has is known
    far better than either, and is what people feel.

    Parameters
    ----------
    grown : the model with everything in it that was found, and friction that may differ
    since : labels of the later runs
    later : the later recordings beside a model of them
    """
    rows = np.maximum(np.sum([one.moving.sum(axis=0) for one in later], axis=0), 1)
    speeds = np.sum([(np.abs(one.dq) * one.moving).sum(axis=0) for one in later], axis=0) / rows
    taken = np.sum([_taken(one) for one in later], axis=0) / rows
    return tuple(
        replace(found, before=float(taken[j]) - found.value)
        for j, joint in enumerate(grown.model.robot.joints)
        for found in _at_speed(grown, since, joint, float(speeds[j]))
    )


def _taken(one: Comparison) -> FloatArray:
    """(n,): what joints take along their motion beside the rigid body's torque; what they only hold evens out."""
    return np.asarray((np.sign(one.dq) * (one.predicted - one.load) * one.moving).sum(axis=0))


def _lacking(grown: Identification, since: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """The friction that the model has of all runs and not yet, by joint, of the later ones: effects and joints."""
    there = {(column.effect, column.link) for column in grown.model.kept if column.runs == since}
    found: dict[str, tuple[str, ...]] = {}
    for column in grown.model.kept:
        place = (column.effect, column.link)
        if not column.runs and role_of(column) in ("dry", "damping") and place not in there:
            found[column.effect] = (*found.get(column.effect, ()), column.link)
    return found


def _at_speed(
    grown: Identification, since: tuple[str, ...], joint: Joint, speed: float
) -> Iterator[FrictionDifference]:
    """What the parameters of one joint say at a speed; nothing where it stands, or the data determine none of them."""
    direction = np.array(
        [
            _torque_of(column, speed) if column.link == joint.name and column.runs == since else 0.0
            for column in grown.model.kept
        ]
    )
    index = np.flatnonzero(direction)
    if not len(index) or speed == 0.0:
        return
    along, statistics = direction[index], grown.statistics
    deviation = np.sqrt(max(float(along @ statistics.covariance[np.ix_(index, index)] @ along), 0.0))
    half = float(stdtrit(statistics.freedom[index].min(), 0.975) * deviation)
    value = float(along @ grown.values[index])
    yield FrictionDifference(joint.name, speed, value, (value - half, value + half), joint.effort_unit, 0.0)


def _torque_of(column: Column, speed: float) -> float:
    """Torque at a speed that a unit of a column's parameter is: of Coulomb and viscous friction."""
    role = role_of(column)
    return 1.0 if role == "dry" else speed if role == "damping" else 0.0
