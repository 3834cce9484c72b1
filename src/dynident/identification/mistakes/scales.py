"""Torques in another unit, or by another gain: many times what the description's own masses would need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.mistakes.swaps import Motion
from dynident.robot.model import Robot
from dynident.robot.pinocchio_model import described_torque

FAR = 6.0
"""Times the description's load from which on a torque is in another unit: masses of descriptions are wrong by up to 3.5
on the open recordings, in joints whose torque they explain (`benchmarks/gross_mistakes.py`)."""

EXPLAINED = 0.9
"""Share of the torque, beside friction and inertia of the drive, that the description's load has to explain. A load at
the flange that it lacks explains 0.7 of a wrist's, 36 times too large."""

VOTES, EXPLAINED_OF_VOTES, FAR_OF_VOTES = 3, 0.15, 5.0
"""Joints whose load explains some of their torques, and times the description's load in the middle of them, from which
on all torques are in another unit: at most 2.4 on the open recordings (`benchmarks/planted_mistakes.py`)."""


@dataclass(frozen=True)
class Scale:
    """A joint, from 0, whose torque is `times` what its links' masses need, and the power of ten that it is off by."""

    joint: int
    times: float
    power: float


def scales_of(robot: Robot, motion: Motion) -> tuple[Scale, ...] | None:
    """The joints whose torques are in another unit; None where the description gives no masses."""
    told = _told(robot, motion)
    if told is None:
        return None
    middle = _middle(told) or 1.0
    if not 1.0 / FAR_OF_VOTES < middle < FAR_OF_VOTES:
        return tuple(Scale(joint, middle, _power(middle)) for joint in range(robot.n))
    return tuple(
        Scale(joint, times, _power(times))
        for joint, (times, explained) in enumerate(told)
        if explained >= EXPLAINED and not 1.0 / FAR < times < FAR and times > 0
    )


def usual_scale(robot: Robot, motion: Motion) -> float | None:
    """How many times the description's load the torques are, in the middle of the joints that say so; None of none."""
    told = _told(robot, motion)
    return None if told is None else _middle(told)


def _middle(told: Sequence[tuple[float, float]]) -> float | None:
    votes = [times for times, explained in told if explained >= EXPLAINED_OF_VOTES and times > 0]
    return float(np.median(votes)) if len(votes) >= VOTES else None


def _told(robot: Robot, motion: Motion) -> list[tuple[float, float]] | None:
    """Of every joint the factor of the description's load in its torque, and what it explains; None without masses."""
    load = load_of(robot, motion)
    return None if load is None else [_times(load[:, joint], motion, joint) for joint in range(robot.n)]


def load_of(robot: Robot, motion: Motion) -> FloatArray | None:
    """(m, n): torque that the links need as the description has them; None without masses."""
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return None
    return described_torque(robot, motion.q, motion.dq, motion.ddq)


def nearer_to_masses(load: FloatArray | None, motion: Motion, joint: int, factor: float) -> bool:
    """Whether a joint's torque times `factor` is nearer to what the masses need, `load` (m, n); without masses, too."""
    if load is None:
        return True
    needed, own = (float(np.sqrt((one[:, joint] ** 2).mean())) for one in (load, motion.tau))
    return needed <= 0.0 or own <= 0.0 or abs(np.log(factor * own / needed)) < abs(np.log(own / needed))


def _power(times: float) -> float:
    return float(10.0 ** np.rint(np.log10(times)))


def _times(load: FloatArray, motion: Motion, joint: int) -> tuple[float, float]:
    """By which factor a load is in a torque, and which share of what friction and drive leave it explains."""
    dq, tau = motion.dq[:, joint], motion.tau[:, joint]
    others = np.stack([np.sign(dq), dq, np.ones(len(dq)), motion.ddq[:, joint]], axis=1)
    projector = np.linalg.pinv(others)
    load, tau = (one - others @ (projector @ one) for one in (load, tau))
    size, whole = float(load @ load), float(tau @ tau)
    if size <= 0.0 or whole <= 0.0:
        return 1.0, 0.0
    times = float(load @ tau) / size
    return times, times * times * size / whole
