"""Judge a recording by the description's masses: units of the masses, and faults of the columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from scipy.linalg import cholesky, solve_triangular

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.identification.recording_faults.column_faults import ColumnFault, Motion
from dynident.identification.recording_faults.tree_fit import (
    BLOCKS,
    LEAVE_ONE_OUT,
    find_moving_joints,
    find_moving_rows,
)
from dynident.identification.recording_faults.unexplained_torque import (
    CLEARLY,
    CLEARLY_IN_ALL_BLOCKS,
    SURELY,
    UnexplainedTorque,
    compute_load,
    compute_log_shares,
)
from dynident.recordings.recording_metadata import Check
from dynident.robot.pseudo_inertia import DescriptionUnits
from dynident.robot.robot_model import Robot

_FEW_ROWS = 400
"""Rows by which it is estimated what the description leaves: it has a few parameters a joint."""

# Added to the scaled normal matrix, so that it has a Cholesky factor where columns depend on each other.
_RIDGE = 1e-9

DESCRIPTION_UNITS = "description_units"


def report_description_units(units: DescriptionUnits) -> Check:
    """Report a description that is not in SI units.

    Parameters
    ----------
    units : DescriptionUnits
        Its units.
    """
    return Check(
        DESCRIPTION_UNITS,
        "warning",
        f"The robot's description is not in SI units: its {units}. The torques are not the cause. Identification, "
        "priors and exports convert them; other tools will not: write them in kg, m and kg m² in the description.",
    )


@dataclass(frozen=True, eq=False)
class DescriptionFit:
    """Opinion of a robot's description on faults in a motion.

    In few moves a fit of all parameters explains by chance: another order of the columns of a short right motion left
    less by 0.2 and more in five of 180, the description's own masses at most 0.03 less. Where the description explains
    as much as a fit, planted faults left 0.09 less and more without the fault, and most 0.3.

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

    def refutes(self, fault: ColumnFault) -> bool:
        """Tell whether the description explains the torque as the columns are, and no better without a fault.

        It has no opinion on a scaled torque, as its gain is free.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        as_is = self._left_as_is
        if fault.kind == "torque scaled" or as_is is None:
            return False
        mended = self.measure_left(fault)
        if mended is None:
            return False
        explains_as_it_is = as_is.mean() <= self.now.blocks.mean() + self._threshold
        return bool(
            (explains_as_it_is and as_is.mean() - mended.mean() < self._least_fall)
            or self._is_surely_less(as_is, mended)
        )

    def bears_out(self, fault: ColumnFault, unexplained: UnexplainedTorque) -> bool:
        """Tell whether the description, which has constant torques, explains more without a fault.

        Surely so, or as much as a fit does, which leaves `unexplained` without the fault.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        unexplained : UnexplainedTorque
            What a fit of all parameters leaves without it.
        """
        as_is, mended = self._left_as_is, self.measure_left(fault)
        if as_is is None or mended is None:
            return False
        explains_without = mended.mean() <= unexplained.blocks.mean() + self._threshold
        return self._is_surely_less(mended, as_is) or bool(
            explains_without and as_is.mean() - mended.mean() >= self._least_fall
        )

    def surely_demands(self, fault: ColumnFault) -> bool:
        """Tell whether the description surely explains more without a fault.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        as_is, mended = self._left_as_is, self.measure_left(fault)
        return as_is is not None and mended is not None and self._is_surely_less(mended, as_is)

    def compute_shares(self, fault: ColumnFault) -> tuple[float, float] | None:
        """Return the shares of an average joint's torque that the description leaves with a fault and without.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        as_is, mended = self._left_as_is, self.measure_left(fault)
        return None if as_is is None or mended is None else (float(np.exp(as_is.mean())), float(np.exp(mended.mean())))

    def measure_left(self, fault: ColumnFault) -> FloatArray | None:
        """Return what the description leaves in every block (blocks,) without a fault; None without masses.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        if fault not in self._blocks_by_fault:
            self._blocks_by_fault[fault] = measure_blocks_left_by_description(self.robot, fault.mend(self.motion))
        return self._blocks_by_fault[fault]

    def may_demand(self, fault: ColumnFault) -> bool:
        """Tell whether the description may explain more without a fault, by a few rows; also without masses.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        as_is, mended = self._estimate_as_is, self.estimate_left(fault)
        return as_is is None or mended is None or as_is - mended >= 0.5 * self._threshold

    def estimate_left(self, fault: ColumnFault) -> float | None:
        """Return what the description leaves of a few rows without a fault, in the mean; None without masses.

        Parameters
        ----------
        fault : ColumnFault
            The fault.
        """
        motion = fault.mend(self._few_rows)
        if fault.is_of_positions:
            shares = _estimate_shares(motion, compute_load(self.robot, motion))
        else:
            # Neither the load nor other joints depend on the torque of some joints.
            shares = self._few_shares | _estimate_shares(motion, self._few_loads, fault.joints)
        return float(np.mean([*shares.values()])) if shares else None

    def _is_surely_less(self, left: FloatArray, other: FloatArray) -> bool:
        """Tell whether clearly less is left than otherwise, and in most blocks."""
        more = other - left
        error = float(more.std(ddof=1)) / np.sqrt(BLOCKS)
        return bool(more.mean() >= max(self._threshold, SURELY * error))

    def prefers(self, fault: ColumnFault, other: ColumnFault) -> bool:
        """Tell whether the description explains clearly more without one fault than without another.

        It decides between faults that a fit cannot tell apart.

        Parameters
        ----------
        fault, other : ColumnFault
            Two faults.
        """
        first, second = self.measure_left(fault), self.measure_left(other)
        return first is not None and second is not None and second.mean() - first.mean() >= self._threshold

    @property
    def _threshold(self) -> float:
        return CLEARLY / max(int(self.now.moving.sum()), 1)

    @property
    def _least_fall(self) -> float:
        return CLEARLY_IN_ALL_BLOCKS / max(int(self.now.moving.sum()), 1)

    @cached_property
    def _left_as_is(self) -> FloatArray | None:
        return measure_blocks_left_by_description(self.robot, self.motion)

    @cached_property
    def _estimate_as_is(self) -> float | None:
        return float(np.mean([*self._few_shares.values()])) if self._few_shares else None

    @cached_property
    def _few_rows(self) -> Motion:
        every = max(1, len(self.motion.q) // _FEW_ROWS)
        return Motion(*(getattr(self.motion, name)[::every] for name in ("q", "dq", "ddq", "tau", "block", "t")))

    @cached_property
    def _few_loads(self) -> FloatArray | None:
        return compute_load(self.robot, self._few_rows)

    @cached_property
    def _few_shares(self) -> dict[int, float]:
        return _estimate_shares(self._few_rows, self._few_loads)

    @cached_property
    def _blocks_by_fault(self) -> dict[ColumnFault, FloatArray | None]:
        return {}


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
    blocks = measure_blocks_left_by_description(robot, motion)
    return None if blocks is None else float(blocks.mean())


def measure_blocks_left_by_description(robot: Robot, motion: Motion) -> FloatArray | None:
    """Return the same of every block (blocks,).

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    """
    load = compute_load(robot, motion)
    if load is None:
        return None
    moves = find_moving_rows(motion)
    shares = [
        _measure_unexplained(
            _build_columns(motion, load, int(joint)), motion.tau[:, joint], motion.block, moves[:, joint]
        )
        for joint in np.flatnonzero(find_moving_joints(motion))
    ]
    return np.asarray(np.mean(shares, axis=0))


def _estimate_shares(motion: Motion, load: FloatArray | None, joints: Sequence[int] | None = None) -> dict[int, float]:
    """Return the log share of each joint's torque that a load leaves, of all rows that are fitted to.

    Only of joints that move, and of the stated ones; none without a load.
    """
    moves, moving, shares = find_moving_rows(motion), find_moving_joints(motion), {}
    for joint in range(len(moving)) if joints is None else joints:
        if load is None or not moving[joint]:
            continue
        rows = np.column_stack([_build_columns(motion, load, joint), motion.tau[:, joint]])[moves[:, joint]]
        gram = rows.T @ rows
        residual = np.append(-_fit(gram), 1.0)
        shares[joint] = float(compute_log_shares(residual @ gram @ residual, gram[-1, -1]))
    return shares


def _build_columns(motion: Motion, load: FloatArray, joint: int) -> FloatArray:
    """Return the columns (m, 6): load, dry and viscous friction, inertia of the drive, and ± a constant."""
    # A constant of either sign, as two columns that are not negative.
    dq, ones = motion.dq[:, joint], np.ones(len(load))
    return np.stack([load[:, joint], np.sign(dq), dq, motion.ddq[:, joint], ones, -ones], axis=1)


def _measure_unexplained(columns: FloatArray, tau: FloatArray, block: IntArray, moves: BoolArray) -> FloatArray:
    rows = np.concatenate([columns, tau[:, None]], axis=1)
    parts = [rows[moves & (block == number)] for number in range(BLOCKS)]
    grams = np.stack([part.T @ part for part in parts])
    # Inner products of all blocks but each one: every block is then predicted from a fit without it, at no further
    # pass.
    others = np.tensordot(LEAVE_ONE_OUT, grams, axes=1)
    residual = np.stack([np.append(-_fit(gram), 1.0) for gram in others[:-1]])
    squares = np.einsum("bi,bik,bk->b", residual, grams, residual)
    return compute_log_shares(squares, others[-1, -1, -1] / BLOCKS)


def _fit(gram: FloatArray) -> FloatArray:
    """Return the parameters (c,), none of them negative, of inner products (c + 1, c + 1) of [W | Y]."""
    # Columns of equal size, or the ridge would weigh them by their units.
    scale = np.sqrt(np.maximum(np.diag(gram)[:-1], np.finfo(float).tiny))
    normal = gram[:-1, :-1] / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
    # Non-negative least squares on the Cholesky factor has the same solution as on all rows, and is small.
    upper = cholesky(normal)
    scaled_values, _ = scipy.optimize.nnls(upper, solve_triangular(upper, gram[:-1, -1] / scale, trans="T"))
    return scaled_values / scale
