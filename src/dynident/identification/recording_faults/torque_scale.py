"""Find torques in another unit or with another gain, from the description's load and from friction.

Holds the factors from which on a torque is off (4 to 6).

Friction tells the size of a torque where gravity and inertia do not, in first joints and wrists: drives of one robot
are built alike, and lose a similar share of what they can give.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.tree_fit import find_moving_joints
from dynident.robot.pinocchio_conversion import compute_described_torque
from dynident.robot.robot_model import Robot

LARGE_SHARE, HUGE_SHARE, MORE = 0.3, 0.7, 1.1
"""Share of a joint's limit of effort that friction does not take: 0.02 to 0.21 on the open recordings. Between the two
the friction has to be more than any other joint's, too, so many times: limits of small joints are often guessed."""

APART, APART_LARGEST = 4.0, 3.0
"""Times the middle share of the other joints, and the largest of them, that friction does not take of a joint's limit,
too: at most 1.8 and 1.4 on the open recordings, so that 4 is half way from there to ten times."""

APART_INNER, APART_OUTER = 5.0, 2.0
"""Times the friction of every other joint: of the inner half of the joints, whose largest is up to 1.5 times the next
on the open recordings, and of the outer half, whose drives are smaller: at most 0.3 there, and 1.5 is published of a
Panda."""

APART_ALIKE = 5.0
"""Times the friction of every other joint with the same limit of effort, of which there are at least two: their drives
are of one make. At most 2.4 on the open recordings, and this is half way from there to ten times."""

AGREED = 0.75
"""Factor on each of these thresholds where the masses of the description also say that a joint's torque is too
large."""

_PLACEHOLDER = 5000.0
"""N m: limits of effort from there on are placeholders, as are those that all joints share."""

_KNOWN = 0.5
"""Share of a friction by which it may differ between blocks of time and still count as known."""


def find_excess_friction(robot: Robot, frictions: FloatArray, heavy: Collection[int] = ()) -> dict[int, float]:
    """Return the joints whose friction is too large, and how many times that of the others.

    Parameters
    ----------
    robot : Robot
        The robot.
    frictions : (blocks, n)
        Mean torque of each joint's friction in N m or N, from several parts of the motion; NaN where it is not known.
    heavy : collection of int
        Joints whose torque is too large by the masses of the description.

    Returns
    -------
    dict of int to float
        Joint (from 0), and how many times its friction is too large.
    """
    size, known = _summarise_frictions(frictions)
    limits = get_effort_limits(robot)
    if limits is None:
        return _find_by_place(robot, size, known, heavy)
    share = size / limits
    excess: dict[int, float] = {}
    joints = np.arange(robot.n)
    # The torque of one joint alone may be off, or those of all joints from one on, where the outer drives are of
    # another make. Groups have to be tested as such: the wrong ones would count as normal for each other.
    for group in (*(joints == joint for joint in joints), *(joints >= first for first in range(1, robot.n - 1))):
        members, others = np.flatnonzero(known & group), known & ~group
        # One other joint alone is no measure of what is usual.
        if not len(members) or others.sum() < 2:
            continue
        # Compare shares of the limits of effort: large joints have more friction than small ones in N m.
        usual, largest = float(np.median(share[others])), float(share[others].max())
        most = size[others & find_revolute_joints(robot)].max(initial=0.0)
        large = [
            share[joint]
            > _get_threshold_factor(int(joint), heavy) * max(LARGE_SHARE, APART * usual, APART_LARGEST * largest)
            and (size[joint] > MORE * most or share[joint] > HUGE_SHARE)
            for joint in members
        ]
        if all(large):
            excess |= {int(joint): float(share[joint]) / usual for joint in members}
    excess = excess or _find_by_make(robot, size, known, limits)
    by_place = _find_by_place(robot, size, known, heavy)
    return excess or {
        joint: times
        for joint, times in by_place.items()
        if share[joint] > _get_threshold_factor(joint, heavy) * APART * _get_median_of_others(share, joint)
    }


def _find_by_make(robot: Robot, size: FloatArray, known: BoolArray, limits: FloatArray) -> dict[int, float]:
    """Return the revolute joints whose friction is many times that of all others with the same limit of effort."""
    turning = np.flatnonzero(known & find_revolute_joints(robot))
    excess = {}
    for joint in turning:
        alike = [size[other] for other in turning if other != joint and limits[other] == limits[joint]]
        if len(alike) >= 2 and size[joint] > APART_ALIKE * max(alike):
            excess[int(joint)] = float(size[joint] / np.median(alike))
    return excess


def are_nearer_to_others(robot: Robot, frictions: FloatArray, joints: Sequence[int], factor: float) -> bool:
    """Tell whether the torques of some joints times `factor` have a friction nearer to that of all others.

    Friction is compared as a share of the limit of effort, where the description has one. Where it is not known it does
    not contradict.

    Parameters
    ----------
    robot : Robot
        The robot.
    frictions : (blocks, n)
        As in `find_excess_friction`.
    joints : sequence of int
        Numbers of the joints, from 0.
    factor : float
        Factor that the torques are multiplied by.
    """
    size, known = _summarise_frictions(frictions)
    scaled = np.isin(np.arange(robot.n), joints)
    if not (known & ~scaled).any():
        return True
    limits = get_effort_limits(robot)
    share = size if limits is None else size / limits
    times = share[known & scaled] / np.median(share[known & ~scaled])
    # In logarithms: ten times too large is as far off as ten times too small.
    return bool((np.abs(np.log(factor * times)) < np.abs(np.log(times))).all())


def _summarise_frictions(frictions: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the median friction of every joint over the blocks of time (n,), and where the blocks agree (n,)."""
    size = np.median(frictions, axis=0)
    known = np.isfinite(size) & (size > 0)
    known &= np.ptp(np.where(known, frictions, 0.0), axis=0) < _KNOWN * np.where(known, size, 1.0)
    return size, known


def get_effort_limits(robot: Robot) -> FloatArray | None:
    """Return the limits of effort (n,) in N m or N; None where the description gives none, or placeholders."""
    # Limits that all joints share, or huge ones, were filled in and say nothing of the drives.
    limits = np.array([joint.limits.effort or np.nan for joint in robot.joints], dtype=np.float64)
    if not np.isfinite(limits).all() or len(set(limits.tolist())) == 1 or limits.max() >= _PLACEHOLDER:
        return None
    return limits


def _get_median_of_others(share: FloatArray, joint: int) -> float:
    return float(np.nanmedian(np.delete(share, joint)))


def _get_threshold_factor(joint: int, heavy: Collection[int]) -> float:
    return AGREED if joint in heavy else 1.0


def find_revolute_joints(robot: Robot) -> BoolArray:
    """Return which joints turn (n,).

    Parameters
    ----------
    robot : Robot
        The robot.
    """
    return np.array([joint.kind == "revolute" for joint in robot.joints])


def _find_by_place(robot: Robot, size: FloatArray, known: BoolArray, heavy: Collection[int]) -> dict[int, float]:
    """Return the revolute joint whose friction is many times that of every other, if there is one."""
    turning = find_revolute_joints(robot) & known
    if turning.sum() < 3:
        return {}
    order = np.flatnonzero(turning)[np.argsort(size[turning])]
    largest, next_one = int(order[-1]), int(order[-2])
    times = float(size[largest] / size[next_one])
    if times <= _get_threshold_factor(largest, heavy) * (APART_INNER if largest < robot.n / 2 else APART_OUTER):
        return {}
    alike = size[turning & (np.arange(robot.n) != largest)]
    # An outer joint is compared with the outer ones, whose drives are smaller than the inner ones'.
    outer = [size[joint] for joint in order[:-1] if joint >= robot.n / 2]
    usual = float(np.median(outer)) if largest >= robot.n / 2 and outer else float(alike.max())
    return {largest: float(size[largest]) / usual}


FAR = 6.0
"""Times the description's load from which on a torque is in another unit: masses of descriptions are wrong by up to 3.5
on the open recordings, in joints whose torque they explain (`benchmarks/gross_mistakes.py`)."""

EXPLAINED = 0.9
"""Share of the torque, beside friction and inertia of the drive, that the description's load has to explain. A load at
the flange that it lacks explains 0.7 of a wrist's, 36 times too large."""

VOTES, EXPLAINED_OF_VOTES, FAR_OF_VOTES = 3, 0.15, 5.0
"""Joints whose load explains some of their torques, and times the description's load in the middle of them, from which
on all torques are in another unit: at most 2.4 on the open recordings (`benchmarks/planted_mistakes.py`)."""

BEARING = 0.3
"""Share of the largest load from which on a joint carries the arm: those are the shoulder and the elbow. Their torques
are 0.1 to 3 times the load on the open recordings (`benchmarks/planted_mistakes.py`)."""

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
    """A joint whose torque is many times what it should be.

    Parameters
    ----------
    joint : int
        Number of the joint, from 0.
    times : float
        How many times its torque is too large.
    power : float
        The power of ten that it is off by.
    by_friction : bool
        Whether this follows from the friction of the other joints, and not from the masses of the description.
    """

    joint: int
    times: float
    power: float
    by_friction: bool = False


def find_torque_scales(
    robot: Robot, motion: Motion, excess: Mapping[int, float], frictions: FloatArray | None = None
) -> tuple[TorqueScale, ...] | None:
    """Return the joints whose torques are in another unit.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    excess : mapping of int to float
        Joints whose friction is too large, and how many times, from `find_excess_friction`.
    frictions : (blocks, n), optional
        As in `find_excess_friction`.

    Returns
    -------
    tuple of TorqueScale or None
        None where the description gives no masses and friction shows no excess.
    """
    factors, load = _compare_with_masses(robot, motion), compute_described_load(robot, motion)
    if factors is None or load is None:
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
    # What the load takes and gives back says nothing of a drive; the rest works against friction.
    rest = motion.tau - load * [times for times, _ in factors]
    driving = find_driving_joints(motion) | find_driving_joints(replace(motion, tau=rest))
    # The masses come first. Friction decides only for joints whose load explains too little of their torque.
    explained = {joint: times for joint, (times, share) in enumerate(factors) if share >= EXPLAINED and times > 0}
    far = {
        joint: times
        for joint, times in explained.items()
        if not 1.0 / FAR < times < FAR and (times > 1.0 or driving[joint])
    }
    fair = [joint for joint in range(robot.n) if joint not in far]
    if frictions is not None and len(fair) > 1:
        # In another unit friction is off the same way: alone the load is that of a tool without a description.
        beside = {joint: np.where(np.isin(np.arange(robot.n), [joint, *fair]), frictions, np.nan) for joint in far}
        far = {
            joint: times
            for joint, times in far.items()
            if are_nearer_to_others(robot, beside[joint], [joint], 0.9 if times > 1.0 else 1.1)
        }
    # A joint that carries most of the arm needs little of its load to tell that a torque is far too large: neither
    # friction nor a load at the flange is several times that. A motor that is off looks too small in any joint.
    for joint in np.flatnonzero(_find_bearing_joints(robot, motion)):
        times, share = factors[joint]
        if share >= EXPLAINED_OF_VOTES and times > FAR_OF_VOTES:
            far.setdefault(int(joint), times)
    by_masses = (TorqueScale(joint, times, _round_to_power(times)) for joint, times in sorted(far.items()))
    others = {joint: times for joint, times in excess.items() if joint not in explained and joint not in far}
    return (*by_masses, *_build_scales_by_friction(others))


def _find_bearing_joints(robot: Robot, motion: Motion) -> BoolArray:
    """Return the joints (n,) that carry the arm, by the masses of the description."""
    load = compute_described_load(robot, motion)
    size = np.zeros(robot.n) if load is None else np.sqrt((load**2).mean(axis=0))
    return np.asarray((size > 0.0) & (size >= BEARING * size.max()))


def _agrees_with_masses(times: float, share: float) -> bool:
    """Tell whether a torque is what the masses of the description need, as far as they explain it."""
    return share >= EXPLAINED_OF_GROUP and 1.0 / FAR_OF_VOTES < times < FAR_OF_VOTES


def find_heavy_joints(robot: Robot, motion: Motion) -> set[int]:
    """Return joints whose torque is several times what the masses need; another sign has to confirm it.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    """
    factors = _compare_with_masses(robot, motion) or ()
    return {joint for joint, (times, share) in enumerate(factors) if share >= EXPLAINED_OF_VOTES and times > HEAVY}


def find_joints_of_right_size(robot: Robot, motion: Motion) -> set[int]:
    """Return joints whose torque is what the masses of the description need, whatever their friction is.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    """
    factors = _compare_with_masses(robot, motion) or ()
    return {joint for joint, factor in enumerate(factors) if _agrees_with_masses(*factor)}


def _build_scales_by_friction(excess: Mapping[int, float]) -> tuple[TorqueScale, ...]:
    return tuple(TorqueScale(joint, times, _round_to_power(times), by_friction=True) for joint, times in excess.items())


def compute_median_scale(robot: Robot, motion: Motion) -> float | None:
    """Return the median ratio of the torques to the description's load; None where too few joints tell.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
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
    load, moving = compute_described_load(robot, motion), find_moving_joints(motion)
    if load is None:
        return None
    return [_compare_load(load[:, joint], motion, joint) if moving[joint] else (1.0, 0.0) for joint in range(robot.n)]


@lru_cache(maxsize=1)
def compute_described_load(robot: Robot, motion: Motion) -> FloatArray | None:
    """Return the torque (m, n) that the links need as the description has them; None without masses.

    That of the last motion is kept, since several checks ask for it.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    """
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
        Filtered rows of the recording.
    joint : int
        Number of the joint, from 0.
    factor : float
        Factor that the torque is multiplied by.
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
        The robot.
    motion : Motion
        Filtered rows of the recording.
    joints : sequence of int
        Numbers of the joints, from 0.
    factor : float
        Factor that the torque is multiplied by.
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


def find_driving_joints(motion: Motion, *, surely: bool = True) -> BoolArray:
    """Return the joints (n,) whose torque does work on them, as that of a drive against friction.

    A motor that is off does none: its torque is what it generates, or noise, and not a torque in another unit.

    Parameters
    ----------
    motion : Motion
        Filtered rows of the recording.
    surely : bool
        Whether the work has to be clear of what it differs between blocks of time.
    """
    driving = []
    for dq, tau in zip(motion.dq.T, motion.tau.T, strict=True):
        work, squares = (np.bincount(motion.block, weights=dq * other).astype(np.float64) for other in (tau, dq))
        driving.append(work.sum() > 0.0 and (not surely or _is_known(work, squares)))
    return np.array(driving)


def _is_known(products: FloatArray, squares: FloatArray) -> bool:
    """Tell whether a factor is surely not zero, from its sums in each block of time (blocks,), by the jackknife."""
    others = squares.sum() - squares
    if len(squares) < 2 or not (others > 0).all():
        return False
    # The factor without each block in turn: its scatter is the jackknife's standard error.
    without = (products.sum() - products) / others
    error = float(np.sqrt((len(without) - 1) * without.var()))
    return bool(abs(products.sum() / squares.sum()) >= KNOWN * error)
