"""Whether the load of gravity is in a torque, and in which direction it pulls: told by the robot's own dynamics."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.mistakes.described import left_by_description
from dynident.identification.mistakes.judge import BLOCKS
from dynident.identification.mistakes.scales import KNOWN
from dynident.identification.mistakes.search import left_of
from dynident.identification.mistakes.swaps import Motion
from dynident.robot.model import Robot
from dynident.robot.pinocchio_model import described_torque

_STATES = 400
_HEAVY = 0.3
"""Of the largest load of gravity: joints with more are asked."""
_ABSENT, _SEEN, _MOST = 0.25, 0.5, 6.0
"""Gravity's share over inertia's below which it is absent, and the shares of inertia that are to be believed: of the
torques of open recordings gravity's is at least 0.4 times inertia's; where it was taken out at most 0.15, and where all
that the robot needs was, inertia's is at most 0.4 (`benchmarks/effort_kinds.py`)."""
_APART, _EXPLAINED = 1.7, 0.3
"""Times what the robot's dynamics leave with gravity that they leave without it: at least that in right torques; and
what they may leave."""
_POOR = 0.15
"""Left of the torque from which on another direction of gravity is looked for: at most 0.11 on the open recordings."""
_CLEARLY = 1.25
"""Times what the next direction has to leave of the torque."""
_BORNE_OUT = 0.3
"""Mean logarithm by which the description leaves less with its gravity than without, from which on gravity is there: in
right short motions 0.6 and more, where it was taken out of them at most 0.1."""
_GRAVITY = 9.81


@dataclass(frozen=True)
class Shares:
    """Of the torque that the description's masses need, how much of gravity's part and of motion's is there.

    `motion_error` is the standard error of motion's, by the jackknife over blocks of time.
    """

    gravity: float
    motion: float
    motion_error: float = 0.0


@dataclass(frozen=True, eq=False)
class Mounting:
    """Gravity (3,) in the base frame in m/s² that explains most, what it leaves of the torque, and what the stated one.

    `is_sure` says whether it leaves clearly less than every other direction along an axis.
    """

    gravity: FloatArray
    left: float
    left_as_stated: float
    is_sure: bool


def shares_of(robot: Robot, motion: Motion, factor: float = 1.0) -> Shares | None:
    """What is in a torque of the description's load; `factor` makes N m of it. None without masses or gravity."""
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0) or not np.linalg.norm(robot.gravity) > 1.0:
        return None
    every = max(1, len(motion.q) // _STATES)
    q, dq, ddq, tau = (one[::every] for one in (motion.q, motion.dq, motion.ddq, motion.tau * factor))
    others = motion.block[::every] != np.arange(BLOCKS)[:, None]
    load = _load(robot, q)
    rest = described_torque(robot, q, dq, ddq) - load
    size = np.sqrt((load**2).mean(axis=0))
    shares = []
    for joint in np.flatnonzero((size > _HEAVY * size.max()) & (np.ptp(load, axis=0) > 0)):
        speed = dq[:, joint]
        rows = np.column_stack([load[:, joint], rest[:, joint], speed, np.sign(speed)])
        length = np.sqrt((rows**2).sum(axis=0)) + 1e-30
        asked = (np.ones(len(rows), dtype=bool), *others)
        told = [np.linalg.lstsq(rows[at] / length, tau[at, joint], rcond=1e-10)[0][:2] for at in asked]
        shares.append(np.array(told) / length[:2])
    if not shares:
        return None
    (gravity, inertia), *without = np.median(np.abs(shares), axis=0)
    error = np.sqrt((BLOCKS - 1) * np.var([one[1] for one in without]))
    return Shares(float(gravity), float(inertia), float(error))


def compensated(robot: Robot, motion: Motion, factor: float = 1.0) -> Shares | None:
    """The shares where the load of gravity was taken out of a torque; None where it was not, or nothing tells."""
    found = shares_of(robot, motion, factor)
    if found is None or found.gravity > _ABSENT * found.motion or not _SEEN < found.motion < _MOST:
        return None
    if found.motion < KNOWN * found.motion_error:
        return None
    floating = replace(robot, gravity=np.zeros(3))
    without, with_it = left_of(floating, motion), left_of(robot, motion)
    if without >= min(_APART * with_it, _EXPLAINED) or _is_borne_out(robot, floating, motion):
        return None
    # Gravity that pulls in another direction than is stated is not in that load either.
    return None if mounting_of(robot, motion).left * _CLEARLY < without else found


def _is_borne_out(robot: Robot, floating: Robot, motion: Motion) -> bool:
    """Whether the description explains more with its gravity than without: few moves do not tell motion's share."""
    with_it, without = left_by_description(robot, motion), left_by_description(floating, motion)
    return with_it is not None and without is not None and with_it < without - _BORNE_OUT


def other_mounting(robot: Robot, motion: Motion, left: float) -> Mounting | None:
    """Another direction of gravity that surely explains more than the stated one, which leaves `left`; else None."""
    if left < _POOR or not np.linalg.norm(robot.gravity) > 1.0:
        return None
    found = mounting_of(robot, motion)
    better = found.is_sure and found.left * _CLEARLY < found.left_as_stated
    return found if better and found.left < _EXPLAINED else None


def mounting_of(robot: Robot, motion: Motion) -> Mounting:
    """Find the axis of the base frame along which gravity pulls: of a robot on a floor, a wall or a ceiling.

    Up and down often explain a torque alike; the masses of the description decide then, if it has any.
    """
    directions = [sign * axis * _GRAVITY for axis in np.eye(3) for sign in (1.0, -1.0)]
    left = np.array([left_of(replace(robot, gravity=one), motion) for one in directions])
    best = int(np.argmin(left))
    twin = best ^ 1
    alike = left[twin] < _CLEARLY * left[best]
    if alike:
        for place in (best, twin):
            turned = replace(robot, gravity=directions[place])
            if _is_upright(turned, motion):
                best, twin, alike = place, place ^ 1, False
                break
    others = [one for place, one in enumerate(left) if place not in (best, twin)]
    return Mounting(
        directions[best],
        float(left[best]),
        left_of(robot, motion),
        bool(not alike and min(others) > _CLEARLY * left[best]),
    )


def _is_upright(robot: Robot, motion: Motion) -> bool:
    """Whether the loads of the description pull as the torques say."""
    if robot.inertias is None or not np.any(robot.inertias[:, 9] > 0):
        return False
    every = max(1, len(motion.q) // _STATES)
    load = _load(robot, motion.q[::every])
    size = (load**2).sum(axis=0)
    heavy = size > _HEAVY**2 * size.max()
    return bool(((load * motion.tau[::every]).sum(axis=0)[heavy] > 0).all())


def _load(robot: Robot, q: FloatArray) -> FloatArray:
    """(m, n): torque that holds the description's links against gravity."""
    return described_torque(robot, q, np.zeros_like(q), np.zeros_like(q))
