"""Detect torques that a controller commands against gravity: they hold neither friction nor inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IntArray
from dynident.identification.mistakes.judge import BLOCKS, HeldOutFit
from dynident.identification.mistakes.swaps import Motion
from dynident.robot.model import Robot

_STATIC_ROWS = 800
"""Rows that are used: a load of gravity has a few parameters a joint."""

_HEAVY_TORQUE = 0.3
"""Share of the largest torque above which a joint takes part: what gravity leaves of the others' is noise."""

_UNEXPLAINED_BY_GRAVITY = 0.2
"""Share of a joint's torque that the load of gravity may leave, in blocks of time that were not fitted to."""

_NO_FRICTION = 0.01
"""Share of a joint's torque that friction and inertia together may have: of measured torques friction alone has 0.02
and more, even of direct drives, since joints move on bearings and seals."""

_BY_CHANCE = 0.15
"""Share of the load's residual that three columns explain of correlated noise in a few hundred rows, by chance."""

_MOVES = 0.01
"""rad or m that the fastest joint must move in the mean, or nothing tells friction."""


@dataclass(frozen=True)
class StaticTorque:
    """Shares of a torque that the load of gravity leaves, and that friction and inertia have.

    Each is the largest of any joint; `joints` are those that were tested.
    """

    unexplained: float
    moving_share: float
    joints: tuple[int, ...]


def find_static_torque(robot: Robot, motion: Motion, judge: HeldOutFit) -> StaticTorque | None:
    """Decide whether gravity alone explains a torque, and motion has no part in it.

    Parameters
    ----------
    robot : Robot
    motion : Motion
        Filtered rows. Joints without torque are not tested.
    judge : Judge
        That of the robot.

    Returns
    -------
    StaticTorque or None
        None where motion has a part in it, or the data do not tell.
    """
    if not np.linalg.norm(robot.gravity) > 1.0 or float(np.std(motion.q, axis=0).max(initial=0.0)) < _MOVES:
        return None
    every = max(1, len(motion.q) // _STATIC_ROWS)
    q, dq, ddq, tau = (part[::every] for part in (motion.q, motion.dq, motion.ddq, motion.tau))
    block = motion.block[::every]
    spread = tau.std(axis=0)
    heavy: BoolArray = (spread > _HEAVY_TORQUE * spread.max(initial=0.0)) & (dq.std(axis=0) > 0)
    loads = judge.compute_load_columns(q)
    shares: list[tuple[float, float]] = []
    for joint in np.flatnonzero(heavy):
        own = np.column_stack([np.sign(dq[:, joint]), dq[:, joint], ddq[:, joint]])
        share_left, moving = _measure_static_shares(loads[joint], own, tau[:, joint], block)
        if share_left > _UNEXPLAINED_BY_GRAVITY or moving > max(_NO_FRICTION, _BY_CHANCE * share_left):
            return None
        shares.append((share_left, moving))
    if not shares:
        return None
    worst = np.max(shares, axis=0)
    return StaticTorque(float(worst[0]), float(worst[1]), tuple(int(joint) for joint in np.flatnonzero(heavy)))


def _measure_static_shares(loads: FloatArray, own: FloatArray, tau: FloatArray, block: IntArray) -> tuple[float, float]:
    """Return the shares of a joint's torque that the load leaves, held out, and of friction and inertia."""
    rows = np.column_stack([loads, np.ones(len(tau)), own])
    rows = rows / np.maximum(np.sqrt((rows**2).mean(axis=0)), np.finfo(float).tiny)
    n = rows.shape[1] - own.shape[1]
    squares = 0.0
    for number in range(BLOCKS):
        # Held out by blocks: the columns of the load could explain a short piece of any torque that they are fitted
        # to.
        inside = block != number
        solved = np.linalg.lstsq(rows[inside, :n], tau[inside], rcond=1e-6)[0]
        squares += float(((tau[~inside] - rows[~inside, :n] @ solved) ** 2).sum())
    size = float((tau**2).sum())
    # Only what friction and inertia explain beyond the load counts as theirs: in a small motion they may look like a
    # load.
    by_load, by_all = (tau - part @ np.linalg.lstsq(part, tau, rcond=1e-6)[0] for part in (rows[:, :n], rows))
    moving = max(float((by_load**2).sum() - (by_all**2).sum()), 0.0)
    return float(np.sqrt(squares / size)), float(np.sqrt(moving / size))
