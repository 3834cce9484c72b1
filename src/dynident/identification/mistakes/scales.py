"""Torques in another unit, or by another gain: many times what the description's masses or friction would need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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


KNOWN = 3.0
"""Standard errors, among blocks of time, that a joint's factor has to be, or nothing is told of it: where a joint moves
too little, what its friction leaves looks like many times a load that is nearly none (2.8 of a right short motion)."""

EXPLAINED_OF_GROUP = 0.5
"""The same from which on the load of a joint tells by how much a group of joints is off: without it a power of ten is
said, and 0.5 are clear of what a wrist's friction leaves of it."""

A_POWER, SAME_POWER = 1.6, 10.0
"""Times a power of ten to which a ratio of masses is taken for it, since most units are powers of ten and descriptions'
masses are off by half; and times the factor that explains most up to which masses are believed: what is left is flat
there."""

HEAVY = 4.0
"""Times the description's load from which on the torque of a joint that it explains a little may be too large: a load
at the flange makes it so of wrists, so that friction has to say it, too."""


@dataclass(frozen=True)
class Scale:
    """A joint, from 0, whose torque is `times` what it should be, and the power of ten that it is off by.

    That is told by the masses of the description, or by the friction of the other joints: `by_friction`.
    """

    joint: int
    times: float
    power: float
    by_friction: bool = False


def scales_of(robot: Robot, motion: Motion, excess: Mapping[int, float]) -> tuple[Scale, ...] | None:
    """The joints whose torques are in another unit; None where the description gives no masses and friction tells none.

    `excess` are the joints whose friction is too large, and how many times, as `frictions.excess_of` tells.
    """
    told = _told(robot, motion)
    if told is None:
        return _by_friction(excess) or None
    middle = _middle(told) or 1.0
    if not 1.0 / FAR_OF_VOTES < middle < FAR_OF_VOTES:
        # The majority may be of another make, and the others right.
        right = {joint for joint, (times, share) in enumerate(told) if _agrees(times, share)}
        middle = _middle([told[joint] for joint in range(robot.n) if joint not in right]) or middle
        return tuple(Scale(joint, middle, _power(middle)) for joint in range(robot.n) if joint not in right)
    explained = {joint: times for joint, (times, share) in enumerate(told) if share >= EXPLAINED and times > 0}
    by_masses = (
        Scale(joint, times, _power(times)) for joint, times in explained.items() if not 1.0 / FAR < times < FAR
    )
    others = {joint: times for joint, times in excess.items() if joint not in explained}
    return (*by_masses, *_by_friction(others))


def _agrees(times: float, share: float) -> bool:
    """Tell whether a torque is what the masses of the description need, as far as it tells."""
    return share >= EXPLAINED_OF_GROUP and 1.0 / FAR_OF_VOTES < times < FAR_OF_VOTES


def heavy_joints(robot: Robot, motion: Motion) -> set[int]:
    """Joints whose torque is several times what the masses need, as far as they tell: others must say so, too."""
    told = _told(robot, motion) or ()
    return {joint for joint, (times, share) in enumerate(told) if share >= EXPLAINED_OF_VOTES and times > HEAVY}


def _by_friction(excess: Mapping[int, float]) -> tuple[Scale, ...]:
    return tuple(Scale(joint, times, _power(times), by_friction=True) for joint, times in excess.items())


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


def by_masses(robot: Robot, motion: Motion, joints: Sequence[int], factor: float) -> float:
    """Give the factor that makes of the torques of some joints what the description's masses need.

    It is `factor`, a power of ten, where the masses say about the same, or nothing of these joints.
    """
    told = _told(robot, motion) or ()
    known = [told[k][0] for k in joints if told and told[k][1] >= EXPLAINED_OF_GROUP and told[k][0] > 0]
    if not known:
        return factor
    ratio = 1.0 / float(np.median(known))
    if not 1.0 / SAME_POWER < ratio / factor < SAME_POWER:
        return factor
    power = 10.0 ** np.rint(np.log10(ratio))
    return float(power if 1.0 / A_POWER < ratio / power < A_POWER else f"{ratio:.2g}")


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
    share = times * times * size / whole
    products, squares = (np.bincount(motion.block, weights=load * one).astype(np.float64) for one in (tau, load))
    return times, share if _is_known(products, squares) else 0.0


def _is_known(products: FloatArray, squares: FloatArray) -> bool:
    """Whether a factor is surely not nothing, of the products of each block of time (blocks,), by the jackknife."""
    others = squares.sum() - squares
    if len(squares) < 2 or not (others > 0).all():
        return False
    without = (products.sum() - products) / others
    error = float(np.sqrt((len(without) - 1) * without.var()))
    return bool(abs(products.sum() / squares.sum()) >= KNOWN * error)
