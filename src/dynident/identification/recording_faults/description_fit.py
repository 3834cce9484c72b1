"""A second opinion on faults: the share of the torque that the masses of the description leave unexplained."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.identification.recording_faults.column_faults import ColumnFault, Motion
from dynident.identification.recording_faults.held_out_fit import (
    BLOCKS,
    CLEARLY,
    LEAVE_ONE_OUT,
    UnexplainedTorque,
    compute_log_shares,
    find_moving_joints,
    find_moving_rows,
)
from dynident.identification.recording_faults.torque_scale import compute_described_load
from dynident.robot.model import Robot

# Added to the scaled normal matrix, so that it has a Cholesky factor where columns depend on each other.
_RIDGE = 1e-9


@dataclass(frozen=True, eq=False)
class DescriptionFit:
    """Opinion of a robot's description on faults in a motion.

    In few moves a fit of all parameters explains by chance: another order of the columns of a short right motion left
    less by 0.2 and more in five of 180, the description's own masses at most 0.03 less. Where the description explains
    as much as a fit, planted faults left 0.3 less and more without the fault.

    Parameters
    ----------
    robot : Robot
        The robot with the masses of its description.
    motion : Motion
        Filtered rows of the recording.
    now : UnexplainedTorque
        What a fit of all parameters leaves of the torque as it is.
    """

    robot: Robot
    motion: Motion
    now: UnexplainedTorque

    def refutes(self, mistake: ColumnFault) -> bool:
        """Tell whether the description explains the torque as the columns are, and no better without a fault.

        It has no opinion on a scaled torque, as its gain is free.

        Parameters
        ----------
        mistake : ColumnFault
            The fault.
        """
        if mistake.kind == "torque scaled" or self._unexplained_as_is > self.now.blocks.mean() + self._threshold:
            return False
        mended = measure_left_by_description(self.robot, mistake.mend(self.motion))
        return mended is not None and self._unexplained_as_is - mended < self._threshold

    def prefers(self, mistake: ColumnFault, other: ColumnFault) -> bool:
        """Tell whether the description explains clearly more without one fault than without another.

        It decides between faults that a fit cannot tell apart.

        Parameters
        ----------
        mistake, other : ColumnFault
            Two faults.
        """
        first_left, second_left = (
            measure_left_by_description(self.robot, each.mend(self.motion)) for each in (mistake, other)
        )
        return first_left is not None and second_left is not None and second_left - first_left >= self._threshold

    @property
    def _threshold(self) -> float:
        return CLEARLY / max(int(self.now.moving.sum()), 1)

    @cached_property
    def _unexplained_as_is(self) -> float:
        unexplained = measure_left_by_description(self.robot, self.motion)
        return np.inf if unexplained is None else unexplained


def measure_left_by_description(robot: Robot, motion: Motion) -> float | None:
    """Return the mean logarithm of the unexplained share of the torque, with the description's load on each joint.

    The gain of the load, dry and viscous friction and the inertia of the drive are not negative; a constant torque is
    free. Each block of time is predicted from the others, as in `HeldOutFit.measure_unexplained`.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.

    Returns
    -------
    float or None
        None where the description has no masses.
    """
    load = compute_described_load(robot, motion)
    if load is None:
        return None
    moves = find_moving_rows(motion)
    shares = [
        _measure_unexplained(
            _build_columns(motion, load, int(joint)), motion.tau[:, joint], motion.block, moves[:, joint]
        )
        for joint in np.flatnonzero(find_moving_joints(motion))
    ]
    return float(np.mean(shares))


def _build_columns(motion: Motion, load: FloatArray, joint: int) -> FloatArray:
    """Return the columns (m, 6): load, dry and viscous friction, inertia of the drive, and ± a constant."""
    # A constant of either sign, as two columns that are not negative.
    dq, ones = motion.dq[:, joint], np.ones(len(load))
    return np.stack([load[:, joint], np.sign(dq), dq, motion.ddq[:, joint], ones, -ones], axis=1)


def _measure_unexplained(columns: FloatArray, tau: FloatArray, block: IntArray, moves: BoolArray) -> float:
    rows = np.concatenate([columns, tau[:, None]], axis=1)
    parts = [rows[moves & (block == number)] for number in range(BLOCKS)]
    grams = np.stack([part.T @ part for part in parts])
    # Inner products of all blocks but each one: every block is then predicted from a fit without it, at no further
    # pass.
    others = np.tensordot(LEAVE_ONE_OUT, grams, axes=1)
    residual = np.stack([np.append(-_fit(gram), 1.0) for gram in others[:-1]])
    squares = np.einsum("bi,bik,bk->b", residual, grams, residual)
    return float(compute_log_shares(squares, others[-1, -1, -1] / BLOCKS).mean())


def _fit(gram: FloatArray) -> FloatArray:
    """Return the parameters (c,), none of them negative, of inner products (c + 1, c + 1) of [W | Y]."""
    # Columns of equal size, or the ridge would weigh them by their units.
    scale = np.sqrt(np.maximum(np.diag(gram)[:-1], np.finfo(float).tiny))
    normal = gram[:-1, :-1] / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    # Non-negative least squares on the Cholesky factor has the same solution as on all rows, and is small.
    upper = cholesky(normal)
    scaled_values, _ = nnls(upper, solve_triangular(upper, gram[:-1, -1] / scale, trans="T"))
    return scaled_values / scale
