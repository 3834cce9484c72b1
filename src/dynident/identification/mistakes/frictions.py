"""Find joints whose friction is out of proportion to the others': their torque has another unit or another gain.

Friction tells the size of a torque where gravity and inertia do not, in first joints and wrists: drives of one robot
are built alike, and lose a similar share of what they can give.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.robot.model import Robot

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
    frictions : (blocks, n)
        Mean torque of each joint's friction in N m or N, from several parts of the motion; NaN where it is not known.
    heavy : collection of int
        Joints whose torque is too large by the masses of the description.

    Returns
    -------
    dict of int to float
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
        if not len(members) or others.sum() < 2:
            continue
        # Compare shares of the limits of effort: large joints have more friction than small ones in N m.
        usual, largest = float(np.median(share[others])), float(share[others].max())
        most = size[others & _find_revolute(robot)].max(initial=0.0)
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
    turning = np.flatnonzero(known & _find_revolute(robot))
    excess = {}
    for joint in turning:
        alike = [size[other] for other in turning if other != joint and limits[other] == limits[joint]]
        if len(alike) >= 2 and size[joint] > APART_ALIKE * max(alike):
            excess[int(joint)] = float(size[joint] / np.median(alike))
    return excess


def is_nearer_to_others(robot: Robot, frictions: FloatArray, joint: int, factor: float) -> bool:
    """Tell whether a joint's torque times `factor` has a friction nearer to the others'.

    Friction is compared as a share of the limit of effort, where the description has one. Where it is not known it does
    not contradict.

    Parameters
    ----------
    robot : Robot
    frictions : (blocks, n)
        As in `excess_of`.
    joint : int
    factor : float
    """
    size, known = _summarise_frictions(frictions)
    others = known & (np.arange(robot.n) != joint)
    if not known[joint] or not others.any():
        return True
    limits = get_effort_limits(robot)
    share = size if limits is None else size / limits
    times = float(share[joint] / np.median(share[others]))
    return bool(abs(np.log(factor * times)) < abs(np.log(times)))


def _summarise_frictions(frictions: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Return the median friction of every joint over the blocks of time (n,), and where the blocks agree (n,)."""
    size = np.median(frictions, axis=0)
    known = np.isfinite(size) & (size > 0)
    known &= np.ptp(np.where(known, frictions, 0.0), axis=0) < _KNOWN * np.where(known, size, 1.0)
    return size, known


def get_effort_limits(robot: Robot) -> FloatArray | None:
    """Return the limits of effort (n,) in N m or N; None where the description gives none, or placeholders."""
    limits = np.array([joint.limits.effort or np.nan for joint in robot.joints], dtype=np.float64)
    if not np.isfinite(limits).all() or len(set(limits.tolist())) == 1 or limits.max() >= _PLACEHOLDER:
        return None
    return limits


def _get_median_of_others(share: FloatArray, joint: int) -> float:
    return float(np.nanmedian(np.delete(share, joint)))


def _get_threshold_factor(joint: int, heavy: Collection[int]) -> float:
    return AGREED if joint in heavy else 1.0


def _find_revolute(robot: Robot) -> BoolArray:
    return np.array([joint.kind == "revolute" for joint in robot.joints])


def _find_by_place(robot: Robot, size: FloatArray, known: BoolArray, heavy: Collection[int]) -> dict[int, float]:
    """Return the revolute joint whose friction is many times that of every other, if there is one."""
    turning = _find_revolute(robot) & known
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
