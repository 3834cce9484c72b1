"""Whether a torque is what a controller commands against gravity: it has neither friction nor inertia in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IntArray
from dynident.identification.mistakes.judge import BLOCKS, Judge
from dynident.identification.mistakes.swaps import Motion
from dynident.robot.model import Robot

_STATES = 800
"""Rows that tell: a load of gravity has a few parameters a joint."""

_HEAVY = 0.3
"""Of the largest torque: joints with more are asked. What is left of the others' is noise."""

_EXPLAINED = 0.2
"""Share of a joint's torque that the load of gravity may leave, in blocks of time that were not fitted to."""

_NO_FRICTION = 0.01
"""Share of a joint's torque that friction and inertia together may have: of measured torques friction alone has 0.02
and more, even of direct drives, since joints move on bearings and seals."""

_BY_CHANCE = 0.15
"""Share of what the load leaves that three columns explain of noise in so few hundred rows that hang together."""

_MOVES = 0.01
"""rad or m that the fastest joint must move in the mean, or nothing tells friction."""


@dataclass(frozen=True)
class StaticTorque:
    """What the load of gravity leaves of the torque, and the share that friction and inertia have, at most of a joint.

    `joints` are those that say so.
    """

    left: float
    moving_share: float
    joints: tuple[int, ...]


def find_static_torque(robot: Robot, motion: Motion, judge: Judge) -> StaticTorque | None:
    """Tell whether gravity alone explains a torque, and motion has no part in it; None where it has, or none tells.

    Parameters
    ----------
    robot : Robot
    motion : Motion
        Filtered rows. Joints without torque are not asked.
    judge : Judge
        That of the robot.
    """
    if not np.linalg.norm(robot.gravity) > 1.0 or float(np.std(motion.q, axis=0).max(initial=0.0)) < _MOVES:
        return None
    every = max(1, len(motion.q) // _STATES)
    q, dq, ddq, tau = (part[::every] for part in (motion.q, motion.dq, motion.ddq, motion.tau))
    block = motion.block[::every]
    spread = tau.std(axis=0)
    heavy: BoolArray = (spread > _HEAVY * spread.max(initial=0.0)) & (dq.std(axis=0) > 0)
    loads = judge.loads(q)
    shares: list[tuple[float, float]] = []
    for joint in np.flatnonzero(heavy):
        own = np.column_stack([np.sign(dq[:, joint]), dq[:, joint], ddq[:, joint]])
        left, moving = _shares(loads[joint], own, tau[:, joint], block)
        if left > _EXPLAINED or moving > max(_NO_FRICTION, _BY_CHANCE * left):
            return None
        shares.append((left, moving))
    if not shares:
        return None
    worst = np.max(shares, axis=0)
    return StaticTorque(float(worst[0]), float(worst[1]), tuple(int(joint) for joint in np.flatnonzero(heavy)))


def _shares(loads: FloatArray, own: FloatArray, tau: FloatArray, block: IntArray) -> tuple[float, float]:
    """What the load leaves of a joint's torque, held out, and the share that friction and inertia explain beside it."""
    rows = np.column_stack([loads, np.ones(len(tau)), own])
    rows = rows / np.maximum(np.sqrt((rows**2).mean(axis=0)), np.finfo(float).tiny)
    n = rows.shape[1] - own.shape[1]
    squares = 0.0
    for one in range(BLOCKS):
        inside = block != one
        solved = np.linalg.lstsq(rows[inside, :n], tau[inside], rcond=1e-6)[0]
        squares += float(((tau[~inside] - rows[~inside, :n] @ solved) ** 2).sum())
    size = float((tau**2).sum())
    # What of friction and inertia looks like a load, in a small motion, is none of theirs.
    by_load, by_all = (tau - part @ np.linalg.lstsq(part, tau, rcond=1e-6)[0] for part in (rows[:, :n], rows))
    beside = max(float((by_load**2).sum() - (by_all**2).sum()), 0.0)
    return float(np.sqrt(squares / size)), float(np.sqrt(beside / size))
