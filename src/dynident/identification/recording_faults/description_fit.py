"""Judge a recording by the description's masses: units of the masses, and faults of the columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.errors import Remedy
from dynident.identification.recording_faults.column_faults import ColumnFault, Motion
from dynident.identification.recording_faults.rows_for_fault_search import thin_out
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
from dynident.robot.mjcf_reader import has_gravity_compensation
from dynident.robot.pinocchio_conversion import compute_described_torque
from dynident.robot.pseudo_inertia import DescriptionUnits, find_impossible_links
from dynident.robot.robot_model import Robot

_FEW_ROWS = 400
"""Rows by which it is estimated what the description leaves: it has a few parameters a joint."""

# Added to the scaled normal matrix, so that it can be solved where columns depend on each other.
_RIDGE = 1e-9

_UNITS, _LENGTHS, _INERTIAS = "description_units", "description_lengths", "description_inertias"
DESCRIPTION_CHECKS = (_UNITS, _LENGTHS, _INERTIAS)
"""Checks of the description by itself, which tell nothing of a recording."""

_LONGEST_ARM = 30.0
"""m between the joints of a fixed arm in line: the largest of industry have 5, cranes and gantries up to some 20."""


def check_description(robot: Robot, units: DescriptionUnits | None) -> tuple[Check, ...]:
    """Check a description by itself, without any recording; return what is wrong.

    Parameters
    ----------
    robot : Robot
        As it was described.
    units : DescriptionUnits or None
        Its units, where they are not SI.
    """
    details: dict[str, str] = {}
    if units is not None:
        details[_UNITS] = (
            f"The robot's description is not in SI units: its {units}. The torques are not the cause. Identification, "
            "priors and exports convert them; other tools will not: write them in kg, m and kg m² in the description."
        )
    length = _measure_arm(robot)
    if robot.base == "fixed" and length > _LONGEST_ARM:
        details[_LENGTHS] = (
            f"By its description the arm is {length:.3g} m long from its first joint to its last. If its lengths are "
            f"in cm ({length / 100.0:.2g} m) or mm ({length / 1000.0:.2g} m), write them in m in the description: "
            "until then no inertia, no load and no cause of an error is right."
        )
    if impossible := find_impossible_links(robot):
        details[_INERTIAS] = (
            f"The description gives {', '.join(impossible)} an inertia that no body has (each moment is positive, and "
            "at most the sum of the other two, about the centre of mass): elements may be in a wrong order. "
            "Identification does not use them; priors, designs and simulators do."
        )
    return tuple(Check(name, "warning", detail) for name, detail in details.items())


def _measure_arm(robot: Robot) -> float:
    """Return the length in m of the longest chain of joints in line, without what the first one stands on."""
    lengths: list[float] = []
    for joint in robot.tree.joints:
        own = float(np.linalg.norm(np.asarray(joint.placement)[:3, 3]))
        lengths.append(lengths[joint.parent] + own if joint.parent >= 0 else 0.0)
    return max(lengths, default=0.0)


def describe_weightlessness(robot: Robot) -> tuple[str, tuple[Remedy, ...]]:
    """Return what to do about a torque without gravity where the description takes it off all bodies (`gravcomp`)."""
    if robot.description is None or robot.description.format != "mjcf":
        return "", ()
    if not has_gravity_compensation(robot.description.content):
        return "", ()
    remedy = Remedy("gravity", (0.0, 0.0, 0.0))
    return f" The description has gravity taken off all bodies (gravcomp): of a simulation state {remedy}.", (remedy,)


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
        return thin_out(self.motion, _FEW_ROWS)

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
    grams = np.stack(
        [
            _multiply_by_block(_build_rows(motion, load, joint), motion.block, moves[:, joint])
            for joint in np.flatnonzero(find_moving_joints(motion)).tolist()
        ]
    )
    # Inner products of all blocks but each one: every block is then predicted from a fit without it, at no further
    # pass.
    others = np.einsum("ob,jbik->joik", LEAVE_ONE_OUT, grams)
    squares = _compute_squares(_fit(others[:, :-1]), grams)
    return np.asarray(compute_log_shares(squares, others[:, -1:, -1, -1] / BLOCKS).mean(axis=0))


def _estimate_shares(motion: Motion, load: FloatArray | None, joints: Sequence[int] | None = None) -> dict[int, float]:
    """Return the log share of each joint's torque that a load leaves, of all rows that are fitted to.

    Only of joints that move, and of the stated ones; none without a load.
    """
    if load is None:
        return {}
    moves, moving = find_moving_rows(motion), find_moving_joints(motion)
    own = [joint for joint in (range(len(moving)) if joints is None else joints) if moving[joint]]
    if not own:
        return {}
    rows = [_build_rows(motion, load, joint)[moves[:, joint]] for joint in own]
    grams = np.stack([part.T @ part for part in rows])
    shares = compute_log_shares(_compute_squares(_fit(grams), grams), grams[:, -1, -1])
    return dict(zip(own, shares.tolist(), strict=True))


def _build_rows(motion: Motion, load: FloatArray, joint: int) -> FloatArray:
    """Return the rows (m, 6) of a joint: load, dry and viscous friction, inertia of the drive, a constant; torque."""
    dq = motion.dq[:, joint]
    columns = (load[:, joint], np.sign(dq), dq, motion.ddq[:, joint], np.ones(len(load)), motion.tau[:, joint])
    return np.stack(columns, axis=1)


def _multiply_by_block(rows: FloatArray, block: IntArray, moves: BoolArray) -> FloatArray:
    """Return the inner products (blocks, c, c) of the rows (m, c) of each block in which the joint moves."""
    moving = rows[moves]
    bounds = np.searchsorted(block[moves], np.arange(BLOCKS + 1))
    parts = [moving[bounds[number] : bounds[number + 1]] for number in range(BLOCKS)]
    return np.stack([part.T @ part for part in parts])


def _compute_squares(values: FloatArray, grams: FloatArray) -> FloatArray:
    """Return the squared errors (...) of parameters (..., c) by inner products (..., c + 1, c + 1) of [W | Y]."""
    residual = np.concatenate([-values, np.ones((*values.shape[:-1], 1))], axis=-1)
    return np.asarray(np.einsum("...i,...ik,...k->...", residual, grams, residual))


_ACTIVE = np.array([[*active, 1.0] for active in product((1.0, 0.0), repeat=4)])
"""(16, 5): the sets of parameters that a fit may have, with the constant always among them. As none of the first four
may be negative, the best set whose values are not is the solution, and so few sets are solved at once."""


def _fit(grams: FloatArray) -> FloatArray:
    """Return the parameters (..., 5) of inner products (..., 6, 6) of [W | Y]: all but the constant not negative."""
    # Columns of equal size, or the ridge would weigh them by their units.
    scale = np.sqrt(np.maximum(np.diagonal(grams, axis1=-2, axis2=-1)[..., :-1], np.finfo(float).tiny))
    normal = grams[..., :-1, :-1] / (scale[..., :, None] * scale[..., None, :]) + _RIDGE * np.eye(5)
    right = (grams[..., :-1, -1] / scale)[..., None, :] * _ACTIVE
    # A parameter that is not in a set is 0: it has a row and a column of its own.
    of_sets = normal[..., None, :, :] * (_ACTIVE[:, :, None] * _ACTIVE[:, None, :]) + _UNUSED
    values = np.linalg.solve(of_sets, right[..., None])[..., 0]
    explained = np.where((values[..., :-1] >= 0.0).all(axis=-1), (values * right).sum(axis=-1), -np.inf)
    best = np.argmax(explained, axis=-1)[..., None, None]
    return np.asarray(np.take_along_axis(values, best, axis=-2)[..., 0, :] / scale)


_UNUSED = np.array([np.diag(1.0 - active) for active in _ACTIVE])


_NEAR, _POOR, FAIR = (0.45, 2.1), (0.15, 6.0), (0.2, 3.0)
"""Ranges of measured over described torque: within which they agree, as descriptions are not better; beyond which no
description is off, and it is another torque or unit; and for masses that may be guessed: 2.4 on the open recordings."""
_SURE = 1.25
"""Amplifiers of arms give up to 64 A: per cent of that taken for A make 1.56 times the torque, and of less even more;
this is half as far, as factors go."""
_TRUSTED_VARIANCE, _STATES = 0.3, 400
"""Share of the variance without the load that may be left with it for a joint's scale to be trusted; and rows used."""


@dataclass(frozen=True, eq=False)
class TorqueScales:
    """Measured over described torque of every joint.

    Parameters
    ----------
    values : (n,)
        The ratios.
    trusted : (n,)
        Joints whose ratio can be trusted, as the description's load explains much of their torque.
    """

    values: FloatArray
    trusted: BoolArray

    @property
    def median(self) -> float:
        """Median of the trusted scales, without sign."""
        return float(np.median(np.abs(self.values[self.trusted])))

    def is_plausible(self, factor: float) -> bool:
        """Tell whether the values, times a factor, could be torques of the joints, if the description is poor."""
        return _POOR[0] < self.median * factor < _POOR[1]

    def is_near_one(self, factors: FloatArray) -> bool:
        """Tell whether the trusted values, times factors (n,), agree with the description, as far as descriptions do.

        A payload that it does not have makes some of them larger, and none smaller.
        """
        sizes = np.abs(self.values * factors)[self.trusted]
        return _NEAR[0] < float(sizes.min()) < _NEAR[1] and self.is_fair(factors)

    def is_in_unit(self, factor: float) -> bool:
        """Tell whether the trusted values, all times a unit's factor, agree with the description, and with each other.

        Gears and drive gains make the joints' values differ; a unit does not.
        """
        sizes = np.abs(self.values * factor)[self.trusted]
        return self.is_near_one(np.full(len(self.values), factor)) and float(sizes.max()) < FAIR[1]

    def count_near(self, factor: float) -> int:
        """Count the trusted joints whose values, times a unit's factor, agree with the description."""
        sizes = np.abs(self.values * factor)[self.trusted]
        return int(np.count_nonzero((_NEAR[0] < sizes) & (sizes < _NEAR[1])))

    def is_sure(self, factors: FloatArray) -> bool:
        """Tell whether the trusted values, times factors (n,), show that currents are in the unit of the gains."""
        size = float(np.median(np.abs(self.values * factors)[self.trusted]))
        return 1.0 / _SURE < size < _SURE

    def is_fair(self, factors: FloatArray) -> bool:
        """Tell whether the trusted values, times factors (n,), agree with a description whose masses are guessed."""
        return FAIR[0] < float(np.median(np.abs(self.values * factors)[self.trusted])) < FAIR[1]


def compare_with_description(robot: Robot, motion: Motion) -> TorqueScales | None:
    """Compare torques with those of the description's inertias; None where it gives none, or no joint can be trusted.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    """
    if robot.inertias is None:
        return None
    few = thin_out(motion, _STATES)
    q, dq, ddq, tau = few.q, few.dq, few.ddq, few.tau
    described = compute_described_torque(robot, q, dq, ddq)
    values, trusted = np.zeros(robot.n), np.zeros(robot.n, dtype=bool)
    for joint in range(robot.n):
        speed = dq[:, joint]
        # Friction, inertia of the drive and an offset are free: only what the load adds is compared.
        friction = np.column_stack(
            [speed, np.tanh(speed / (0.05 * speed.std() + 1e-12)), ddq[:, joint], np.ones(len(q))]
        )
        rows = np.column_stack([described[:, joint], friction])
        size = np.sqrt((rows**2).sum(axis=0)) + 1e-30
        solution, *_ = np.linalg.lstsq(rows / size, tau[:, joint], rcond=1e-10)
        other = tau[:, joint] - friction @ np.linalg.lstsq(friction, tau[:, joint], rcond=1e-10)[0]
        # The load has to explain much of what friction leaves, or its factor means nothing.
        remainder = tau[:, joint] - rows / size @ solution
        values[joint] = solution[0] / size[0]
        trusted[joint] = (
            remainder.var() < _TRUSTED_VARIANCE * other.var() and remainder.var() < 0.1 * tau[:, joint].var()
        )
    return TorqueScales(values, trusted) if trusted.any() else None
