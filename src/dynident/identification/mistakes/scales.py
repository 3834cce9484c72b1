"""Find torques in another unit, or with another gain: many times what the description's masses or friction need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.mistakes.swaps import Motion
from dynident.robot.model import Robot
from dynident.robot.pinocchio_model import compute_described_torque

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
class TorqueScale:
    """A joint, from 0, whose torque is `times` what it should be, and the power of ten that it is off by.

    This follows from the masses of the description, or from the friction of the other joints: `by_friction`.
    """

    joint: int
    times: float
    power: float
    by_friction: bool = False


def find_torque_scales(robot: Robot, motion: Motion, excess: Mapping[int, float]) -> tuple[TorqueScale, ...] | None:
    """Return the joints whose torques are in another unit.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    excess : mapping of int to float
        Joints whose friction is too large, and how many times, from `frictions.excess_of`.

    Returns
    -------
    tuple of Scale or None
        None where the description gives no masses and friction shows no excess.
    """
    factors = _compare_with_masses(robot, motion)
    if factors is None:
        return _build_scales_by_friction(excess) or None
    middle = _get_median_vote(factors) or 1.0
    # One factor for most joints: the unit of the file is another, not the gains of single joints.
    if not 1.0 / FAR_OF_VOTES < middle < FAR_OF_VOTES:
        # Most joints are off, but some may be right: those of another make.
        right = {joint for joint, (times, share) in enumerate(factors) if _agrees_with_masses(times, share)}
        middle = _get_median_vote([factors[joint] for joint in range(robot.n) if joint not in right]) or middle
        return tuple(
            TorqueScale(joint, middle, _round_to_power(middle)) for joint in range(robot.n) if joint not in right
        )
    # The masses come first. Friction decides only for joints whose load explains too little of their torque.
    explained = {joint: times for joint, (times, share) in enumerate(factors) if share >= EXPLAINED and times > 0}
    by_masses = (
        TorqueScale(joint, times, _round_to_power(times))
        for joint, times in explained.items()
        if not 1.0 / FAR < times < FAR
    )
    others = {joint: times for joint, times in excess.items() if joint not in explained}
    return (*by_masses, *_build_scales_by_friction(others))


def _agrees_with_masses(times: float, share: float) -> bool:
    """Tell whether a torque is what the masses of the description need, as far as they explain it."""
    return share >= EXPLAINED_OF_GROUP and 1.0 / FAR_OF_VOTES < times < FAR_OF_VOTES


def find_heavy_joints(robot: Robot, motion: Motion) -> set[int]:
    """Return joints whose torque is several times what the masses need; another sign has to confirm it.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    """
    factors = _compare_with_masses(robot, motion) or ()
    return {joint for joint, (times, share) in enumerate(factors) if share >= EXPLAINED_OF_VOTES and times > HEAVY}


def _build_scales_by_friction(excess: Mapping[int, float]) -> tuple[TorqueScale, ...]:
    return tuple(TorqueScale(joint, times, _round_to_power(times), by_friction=True) for joint, times in excess.items())


def compute_median_scale(robot: Robot, motion: Motion) -> float | None:
    """Return the median ratio of the torques to the description's load; None where too few joints tell.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    """
    factors = _compare_with_masses(robot, motion)
    return None if factors is None else _get_median_vote(factors)


def _get_median_vote(factors: Sequence[tuple[float, float]]) -> float | None:
    votes = [times for times, explained in factors if explained >= EXPLAINED_OF_VOTES and times > 0]
    return float(np.median(votes)) if len(votes) >= VOTES else None


def _compare_with_masses(robot: Robot, motion: Motion) -> list[tuple[float, float]] | None:
    """Return for every joint the factor of the description's load in its torque, and the share it explains.

    None without masses.
    """
    load = compute_described_load(robot, motion)
    return None if load is None else [_compare_load(load[:, joint], motion, joint) for joint in range(robot.n)]


def compute_described_load(robot: Robot, motion: Motion) -> FloatArray | None:
    """Return the torque (m, n) that the links need as the description has them; None without masses."""
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return None
    return compute_described_torque(robot, motion.q, motion.dq, motion.ddq)


def is_nearer_to_masses(load: FloatArray | None, motion: Motion, joint: int, factor: float) -> bool:
    """Tell whether a joint's torque times `factor` is nearer to what the masses need; also where they are not known.

    Parameters
    ----------
    load : (m, n), optional
        Torque that the masses need; None without masses.
    motion : Motion
    joint : int
    factor : float
    """
    if load is None:
        return True
    needed, own = (float(np.sqrt((torque[:, joint] ** 2).mean())) for torque in (load, motion.tau))
    return needed <= 0.0 or own <= 0.0 or abs(np.log(factor * own / needed)) < abs(np.log(own / needed))


def refine_factor_by_masses(robot: Robot, motion: Motion, joints: Sequence[int], factor: float) -> float:
    """Return the factor that makes of the torques of some joints what the description's masses need.

    It is `factor`, a power of ten, where the masses say about the same, or nothing of these joints.

    Parameters
    ----------
    robot : Robot
    motion : Motion
    joints : sequence of int
    factor : float
    """
    factors = _compare_with_masses(robot, motion) or ()
    known = [factors[k][0] for k in joints if factors and factors[k][1] >= EXPLAINED_OF_GROUP and factors[k][0] > 0]
    if not known:
        return factor
    # The fit is flat near its best factor, so the factor that the masses give is the better one if it is near.
    ratio = 1.0 / float(np.median(known))
    if not 1.0 / SAME_POWER < ratio / factor < SAME_POWER:
        return factor
    power = 10.0 ** np.rint(np.log10(ratio))
    return float(power if 1.0 / A_POWER < ratio / power < A_POWER else f"{ratio:.2g}")


def _round_to_power(times: float) -> float:
    return float(10.0 ** np.rint(np.log10(times)))


def _compare_load(load: FloatArray, motion: Motion, joint: int) -> tuple[float, float]:
    """Return the factor of a load in a torque, and the share that it explains of what friction and drive leave."""
    dq, tau = motion.dq[:, joint], motion.tau[:, joint]
    others = np.stack([np.sign(dq), dq, np.ones(len(dq)), motion.ddq[:, joint]], axis=1)
    # Project friction and the drive's inertia out of both, so that only what the load explains beyond them counts.
    projector = np.linalg.pinv(others)
    load, tau = (torque - others @ (projector @ torque) for torque in (load, tau))
    size, whole = float(load @ load), float(tau @ tau)
    if size <= 0.0 or whole <= 0.0:
        return 1.0, 0.0
    times = float(load @ tau) / size
    share = times * times * size / whole
    products, squares = (np.bincount(motion.block, weights=load * torque).astype(np.float64) for torque in (tau, load))
    return times, share if _is_known(products, squares) else 0.0


def _is_known(products: FloatArray, squares: FloatArray) -> bool:
    """Tell whether a factor is surely not zero, from its sums in each block of time (blocks,), by the jackknife."""
    others = squares.sum() - squares
    if len(squares) < 2 or not (others > 0).all():
        return False
    without = (products.sum() - products) / others
    error = float(np.sqrt((len(without) - 1) * without.var()))
    return bool(abs(products.sum() / squares.sum()) >= KNOWN * error)
