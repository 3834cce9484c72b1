"""What the masses of the description leave of the torque as its columns are: a second opinion, of a few numbers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from dynident.arrays import BoolArray, FloatArray, IntArray
from dynident.identification.mistakes.judge import BLOCKS, CLEARLY, OTHERS, Left, log_shares, moves_of, moving_joints
from dynident.identification.mistakes.scales import load_of
from dynident.identification.mistakes.swaps import Mistake, Motion
from dynident.robot.model import Robot

_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class SecondOpinion:
    """What a robot's description says of mistakes in a motion of which a fit leaves `now`.

    In few moves a fit of all parameters explains by chance: another order of the columns of a short right motion left
    less by 0.2 and more in five of 180, the description's own masses at most 0.03 less; of what was planted, where the
    description explains as much as a fit, they left 0.3 less and more without it.
    """

    robot: Robot
    motion: Motion
    now: Left

    def refutes(self, mistake: Mistake) -> bool:
        """Whether it explains the torque as the columns are, and no better without a mistake.

        Of a torque that is scaled it says nothing: the gain is free.
        """
        if mistake.kind == "torque scaled" or self._as_is > self.now.blocks.mean() + self._clearly:
            return False
        mended = left_by_description(self.robot, mistake.mended(self.motion))
        return mended is not None and self._as_is - mended < self._clearly

    def prefers(self, mistake: Mistake, other: Mistake) -> bool:
        """Whether it explains clearly more without one mistake than without another that a fit cannot tell from it."""
        one, two = (left_by_description(self.robot, each.mended(self.motion)) for each in (mistake, other))
        return one is not None and two is not None and two - one >= self._clearly

    @property
    def _clearly(self) -> float:
        return CLEARLY / max(int(self.now.moving.sum()), 1)

    @cached_property
    def _as_is(self) -> float:
        found = left_by_description(self.robot, self.motion)
        return np.inf if found is None else found


def left_by_description(robot: Robot, motion: Motion) -> float | None:
    """Mean logarithm of the share of the torque that is left where each joint has its load, a gain, and friction.

    The gain of the load, dry and viscous friction and the inertia of the drive are at least nothing; a constant torque
    is free. Each block of time is told by the others, as in `Judge.left`. None where the description has no masses.
    """
    load = load_of(robot, motion)
    if load is None:
        return None
    moves = moves_of(motion)
    shares = [
        _left(_columns(motion, load, int(joint)), motion.tau[:, joint], motion.block, moves[:, joint])
        for joint in np.flatnonzero(moving_joints(motion))
    ]
    return float(np.mean(shares))


def _columns(motion: Motion, load: FloatArray, joint: int) -> FloatArray:
    """(m, 6): load, dry and viscous friction, inertia of the drive, and a constant of either sign."""
    dq, one = motion.dq[:, joint], np.ones(len(load))
    return np.stack([load[:, joint], np.sign(dq), dq, motion.ddq[:, joint], one, -one], axis=1)


def _left(columns: FloatArray, tau: FloatArray, block: IntArray, moves: BoolArray) -> float:
    rows = np.concatenate([columns, tau[:, None]], axis=1)
    parts = [rows[moves & (block == one)] for one in range(BLOCKS)]
    grams = np.stack([part.T @ part for part in parts])
    others = np.tensordot(OTHERS, grams, axes=1)
    residual = np.stack([np.append(-_fitted(one), 1.0) for one in others[:-1]])
    squares = np.einsum("bi,bik,bk->b", residual, grams, residual)
    return float(log_shares(squares, others[-1, -1, -1] / BLOCKS).mean())


def _fitted(gram: FloatArray) -> FloatArray:
    """(c,): the parameters, none of them negative, of inner products (c + 1, c + 1) of [W | Y]."""
    scale = np.sqrt(np.maximum(np.diag(gram)[:-1], np.finfo(float).tiny))
    normal = gram[:-1, :-1] / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    upper = cholesky(normal)
    found, _ = nnls(upper, solve_triangular(upper, gram[:-1, -1] / scale, trans="T"))
    return found / scale
