"""How much the friction of each joint differs between two sets of recordings, whether that is a finding or not."""

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
from dynident.effects.catalogue import get_role
from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.identification.study.extending import extend_at_once
from dynident.recordings import Recording
from dynident.robot.model import Joint


def add_friction_differences(
    grown: Identification, since: tuple[str, ...], recordings: Sequence[Recording]
) -> Identification:
    """Extend the model so that the friction of every joint may differ in the later runs.

    Friction is hardly ever the same on two days. Where the model has no parameters for differences too small to be
    findings, the values of the findings make up for them, and their intervals do not say so.

    Parameters
    ----------
    grown : Identification
        The model with all findings.
    since : labels of the later runs
    recordings : sequence of Recording

    Returns
    -------
    Identification
    """
    lacking = [
        EffectChoice(effect, joints, (), since) for effect, joints in _list_lacking_friction(grown, since).items()
    ]
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


def compute_friction_differences(
    grown: Identification, since: tuple[str, ...], later: Sequence[Comparison]
) -> tuple[FrictionDifference, ...]:
    """Compute by how much the friction of every joint that moves is larger in the later runs.

    Coulomb and viscous friction make up for each other: their sum at the joint's speed is known far better than either,
    and
    is what people feel.

    Parameters
    ----------
    grown : Identification
        The model with all findings, and with friction that may differ.
    since : labels of the later runs
    later : sequence of Comparison
        The later recordings with a model of them.

    Returns
    -------
    tuple of FrictionDifference
    """
    rows = np.maximum(np.sum([comparison.moving.sum(axis=0) for comparison in later], axis=0), 1)
    speeds = np.sum([(np.abs(comparison.dq) * comparison.moving).sum(axis=0) for comparison in later], axis=0) / rows
    friction_torque = np.sum([_compute_dissipation(comparison) for comparison in later], axis=0) / rows
    return tuple(
        replace(difference, before=float(friction_torque[j]) - difference.value)
        for j, joint in enumerate(grown.model.robot.joints)
        for difference in _yield_difference_at_speed(grown, since, joint, float(speeds[j]))
    )


def _compute_dissipation(comparison: Comparison) -> FloatArray:
    """Return (n,): the sum of the torque along the motion beside the rigid body's."""
    return np.asarray(
        # The sign of the velocity makes dissipated torque add up; torque that only holds the joint changes sign with
        # it.
        (np.sign(comparison.dq) * (comparison.predicted - comparison.load) * comparison.moving).sum(axis=0)
    )


def _list_lacking_friction(grown: Identification, since: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return, by effect, the joints whose friction the model has for all runs and not yet for the later ones."""
    known_places = {(column.effect, column.link) for column in grown.model.kept if column.runs == since}
    lacking: dict[str, tuple[str, ...]] = {}
    for column in grown.model.kept:
        place = (column.effect, column.link)
        if not column.runs and get_role(column) in ("dry", "damping") and place not in known_places:
            lacking[column.effect] = (*lacking.get(column.effect, ()), column.link)
    return lacking


def _yield_difference_at_speed(
    grown: Identification, since: tuple[str, ...], joint: Joint, speed: float
) -> Iterator[FrictionDifference]:
    """Yield the friction difference of one joint at a speed; nothing where it stands or is undetermined."""
    direction = np.array(
        [
            _compute_unit_torque(column, speed) if column.link == joint.name and column.runs == since else 0.0
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


def _compute_unit_torque(column: Column, speed: float) -> float:
    """Return the torque at a speed for a unit of a column's parameter, of Coulomb and viscous friction."""
    role = get_role(column)
    return 1.0 if role == "dry" else speed if role == "damping" else 0.0
