"""Find joint angles counted otherwise than in the description: from other zeros, by other factors, or at motors.

A joint that was not homed has another zero, and all joints have others where positions are counted from the start.
Where a gear ratio is wrong, positions are too large. The motors of a differential turn by sums and differences of two
joints' angles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import Remedy
from dynident.identification.recording_faults.column_faults import MIXINGS, ZEROS, ColumnFault, Motion, list_zeros
from dynident.identification.recording_faults.description_fit import DescriptionFit, measure_left_by_description
from dynident.identification.recording_faults.rows_for_fault_search import thin_out
from dynident.identification.recording_faults.torque_scale import find_revolute_joints
from dynident.identification.recording_faults.tree_fit import find_moving_joints
from dynident.identification.recording_faults.unexplained_torque import (
    CERTAIN,
    CLEARLY_IN_ALL_BLOCKS,
    LEAST_FINE,
    HeldOutFit,
    UnexplainedTorque,
)
from dynident.number_format import format_percent
from dynident.recordings.recording import Recording
from dynident.recordings.recording_metadata import Check, Revision
from dynident.robot.robot_model import Robot

ZERO, ANGLE_FAULTS = "joint_zero", ("joint zero", "joints mixed")

_PARALLEL = 0.999
"""Cosine of the angle between axes, 2.6 degrees, up to which they count as parallel: calibrated robots differ less."""

_AT_START = 1e-3
"""Share of its motion up to which a joint's first position is 0."""
_POOR = 0.1
"""Left of the torque of the joint that is explained worst, from which on such zeros are doubted."""
_ROWS = 400
"""Rows by which the zeros are looked for: an angle a joint is told by few."""
_GRID = np.deg2rad(sorted(range(-150, 181, 30), key=abs))
"""Angles that are tried, no shift first: without masses all are alike."""
_TRIES, _STEPS = 200, 30
"""Fits of the rough search, and steps down the slope."""
_FLAT, _BESIDE = 0.02, np.deg2rad(5.0)
"""Logarithm by which the score has to rise beside a zero, and how far beside, for the data to tell it."""


def find_parallel_axes(robot: Robot) -> BoolArray:
    """Return which joints (n,) turn about an axis parallel to that of the joint before.

    Their angles may be counted together. None are named for a robot whose joints follow others.
    """
    parallel = np.zeros(robot.n, dtype=bool)
    for k in range(1, robot.n if robot.linkage is None else 0):
        joint, before = robot.joints[k], robot.joints[k - 1]
        if joint.parent != k - 1 or {joint.kind, before.kind} != {"revolute"}:
            continue
        across = np.asarray(joint.placement)[:3, :3] @ np.asarray(joint.axis)
        parallel[k] = abs(float(across @ np.asarray(before.axis))) > _PARALLEL
    return parallel


def list_mirrors(robot: Robot, moving: BoolArray) -> list[ColumnFault]:
    """List the faults of drivers that make a robot move like its mirror image, as of the other arm.

    Positions and torques of the joints whose axes lie in the plane of the mirror are turned, for each upright plane
    through the axes of the base; of sliding joints those across it. A level mirror would be another direction of
    gravity. None where an axis is askew, or joints follow others.
    """
    if robot.linkage is not None:
        return []
    rotations: list[FloatArray] = []
    for joint in robot.joints:
        placement = np.asarray(joint.placement)[:3, :3]
        rotations.append(placement if joint.parent < 0 else rotations[joint.parent] @ placement)
    axes = np.array([turn @ np.asarray(joint.axis) for turn, joint in zip(rotations, robot.joints, strict=True)])
    slides = np.array([joint.kind == "prismatic" for joint in robot.joints])
    across = np.abs(axes) > _PARALLEL
    is_plain, upright = across.any(axis=1).all(), np.abs(robot.gravity) < 1e-3 * np.linalg.norm(robot.gravity)
    mirrors = [np.flatnonzero((across[:, k] == slides) & moving) for k in np.flatnonzero(upright & is_plain)]
    return [ColumnFault("joint turned", tuple(own.tolist())) for own in mirrors if 2 < len(own) < robot.n]


def begins_at_zero(recording: Recording, motion: Motion) -> bool:
    """Return whether every joint of several is at 0 in the first row, as where positions are counted from the start."""
    first = next(iter(recording.source.rows(0, 1, 1)))
    span = np.ptp(motion.q, axis=0)
    return recording.n > 1 and bool((np.abs(first.q[0]) <= _AT_START * span).all() and (span > 0).all())


def report_zeros_from_start(
    robot: Robot,
    recording: Recording,
    motion: Motion,
    fit: HeldOutFit,
    otherwise: tuple[UnexplainedTorque, ...],
    q: Sequence[str],
) -> Check | None:
    """Report positions that begin at 0 and do not go with the description's zeros; None where they do.

    Parameters
    ----------
    robot : Robot
        The robot, with masses in SI units.
    recording : Recording
        The recording.
    motion : Motion
        Its filtered rows.
    fit : HeldOutFit
        That of the robot.
    otherwise : tuple of UnexplainedTorque
        What it leaves of the torque as it is, and without the single fault of a column that was found.
    q : sequence of str
        Names of the columns of positions.
    """
    as_is = otherwise[0]
    if as_is.worst_share < _POOR or not begins_at_zero(recording, motion):
        return None
    zeros = _find_zeros(robot, motion, fit)
    # A single one is the zero of that joint, or another direction of gravity.
    if np.count_nonzero(zeros) < 2:
        return None
    unexplained = fit.measure_unexplained(replace(motion, q=motion.q - zeros))
    # So many zeros together explain a little by chance, and a file is refused for them.
    is_clear = as_is.compute_summed_fall_to(unexplained) >= CERTAIN
    if not (is_clear and all(other.is_surely_above(unexplained) for other in otherwise)):
        return None
    stated_zeros = {f"q{joint + 1}": float(f"{zero:.4g}") for joint, zero in enumerate(zeros) if zero}
    remedy = Remedy("zeros", stated_zeros)
    others = [robot.joint_names[joint] for joint, zero in enumerate(zeros) if not zero]
    open_ones = f" Those of {', '.join(others)} do not show in these data." if others else ""
    detail = (
        f"All positions ({q[0]} … {q[-1]}) begin at 0: they seem to be counted from where the robot stood at the "
        "start, and not from the zeros of the description. The robot's dynamics leave "
        f"{format_percent(as_is.average_share, decimals=1)} of an average joint's torque unexplained, and "
        f"{format_percent(unexplained.average_share, decimals=1)} with zeros at {remedy} (in rad).{open_ones} "
        "State the angles at which the robot stood at the start, with the opposite sign, as zeros, for each recording "
        "its own; or log absolute positions."
    )
    # Zeros that do not show differ from recording to recording: a model of this one would fit no other.
    return Check(
        ZERO, "error", detail, q[0], apply=None if others[1:] else Revision(zeros=stated_zeros), remedies=(remedy,)
    )


def _find_zeros(robot: Robot, motion: Motion, fit: HeldOutFit) -> FloatArray:
    """Return the angles (n,) in rad that the positions have too much; 0 where the data do not tell.

    The masses of the description tell roughly, one joint after the other; a fit of all parameters tells the rest.
    """
    few = thin_out(motion, _ROWS)
    joints = [int(joint) for joint in np.flatnonzero(find_revolute_joints(robot))]

    def measure_described(zeros: FloatArray) -> float:
        left = measure_left_by_description(robot, replace(few, q=few.q - zeros))
        return 0.0 if left is None else left

    def measure(zeros: FloatArray) -> float:
        return fit.measure_unexplained(replace(motion, q=motion.q - zeros)).fine_inside

    zeros = np.zeros(robot.n)
    # The zero of the last joint is one with the parameters of its link.
    if not (inner := joints[:-1]):
        return zeros
    for joint in joints:
        tries = [zeros + angle * (np.arange(robot.n) == joint) for angle in _GRID]
        zeros = min(tries, key=measure_described)

    def measure_inner(angles: FloatArray) -> float:
        return measure(_spread(angles, inner, robot.n))

    # Joints with parallel axes trade their zeros for one another: a narrow valley, along which slopes lead.
    rough = scipy.optimize.minimize(measure_inner, zeros[inner], method="Powell", options={
        "xtol": 1e-2, "ftol": 1e-2, "maxfev": _TRIES})  # fmt: skip
    angles = scipy.optimize.minimize(measure_inner, rough.x, method="BFGS", options={"maxiter": _STEPS}).x
    zeros = _spread(angles, inner, robot.n)
    least = measure(zeros)
    for joint in joints:
        beside = [measure(zeros + side * _BESIDE * (np.arange(robot.n) == joint)) - least for side in (-1.0, 1.0)]
        # Nothing changes with this angle: the first joint's about a vertical axis, or that of the last link.
        if max(beside) < _FLAT:
            zeros[joint] = 0.0
    return np.asarray((zeros + np.pi) % (2.0 * np.pi) - np.pi)


def _spread(values: FloatArray, joints: Sequence[int], n: int) -> FloatArray:
    zeros = np.zeros(n)
    zeros[list(joints)] = values
    return zeros


_BY = 0.2
"""rad, or logarithm of a factor, to either side by which it is first tried whether a joint's angle is another one: the
torque then left is nearly a parabola."""

_PROMISING = 0.5 * CLEARLY_IN_ALL_BLOCKS
"""Sum over the joints of the logarithm by which less has to be left with another zero for it to be searched exactly."""

_EXACT, _LEAST_ANGLE, _NOMINAL, _NOMINAL_BY_MASSES = 1e-3, 0.03, 0.05, 0.2
"""rad to which a zero is searched, below which it is none, and from a quarter turn up to which it is taken for one; the
same where only the description's masses tell, which are not exact."""

_DOUBLE = float(np.log(2.0))
_LEAST_SCALE, _MOST_SCALE = float(np.log(1.05)), float(np.log(3.0))
"""Logarithms of the factor of a position: where it is also tried at first, below which it is none (the motor of an
elastic joint is ahead by a few percent of its motion), and the largest."""

_POORLY = 0.2
"""Share left of the torque of the joint that is explained worst, from which on zeros are looked for all around, and
factors near twice and half."""

_TINY = 1e-4

_MIXED = 0.1
"""Share of the torque of both joints of a differential that is left while their columns are those of its motors."""


def list_angle_faults(robot: Robot, motion: Motion, fit: HeldOutFit, now: UnexplainedTorque) -> Iterator[ColumnFault]:
    """Yield zeros of joints, and differentials, that the torque may demand: candidates that are to be judged.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    fit : HeldOutFit
        That of the robot.
    now : UnexplainedTorque
        What it leaves of the motion's torque.
    """
    turns = now.moving & find_revolute_joints(robot)
    is_wide = now.worst_share > _POORLY
    yield from estimate_zeros(robot, motion, fit, range(robot.n), is_wide=is_wide)
    yield from _estimate_scales(motion, fit, is_wide=is_wide)
    # A link may be described in another pose: then its joint and the next one, about a parallel axis, have other zeros.
    parallel = turns & find_parallel_axes(robot) & np.isin(range(robot.n), [joint.parent for joint in robot.joints])
    for joint in np.flatnonzero(parallel[1:] & turns[:-1]).tolist():
        yield from (ColumnFault("joint zero", (joint, joint + 1), angle) for angle in ZEROS)
    crossed = turns & ~find_parallel_axes(robot) & (now.joints > _MIXED)
    for joint in range(1, robot.n):
        # The joint before may well have an axis parallel to that of the one before it.
        before = turns[joint - 1] and now.joints[joint - 1] > _MIXED and robot.joints[joint].parent == joint - 1
        if crossed[joint] and before:
            yield from (ColumnFault("joints mixed", (joint - 1, joint), mixing=mixing) for mixing in MIXINGS)


def estimate_zeros(
    robot: Robot, motion: Motion, fit: HeldOutFit, joints: Iterable[int], *, is_wide: bool
) -> Iterator[ColumnFault]:
    """Yield the zeros of single joints with which a fit leaves less, by a few rows.

    The torque that is left is a smooth function of a zero: where it falls to either side, its lowest point is found.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        Filtered rows of the recording.
    fit : HeldOutFit
        That of the robot.
    joints : iterable of int
        Numbers of the joints that are tried.
    is_wide : bool
        Whether zeros are looked for around quarter turns, too, and not only near those of the description.
    """
    few = thin_out(motion, _ROWS)
    moving = find_moving_joints(few)
    as_is, least_fall = fit.estimate_score(few, LEAST_FINE), _PROMISING / max(int(moving.sum()), 1)
    # The zero of the last joint of a chain is one with the parameters of its link.
    turns = find_revolute_joints(robot) & moving & np.isin(range(robot.n), [joint.parent for joint in robot.joints])
    for joint in (joint for joint in joints if turns[joint]):
        axis = np.arange(robot.n) == joint

        def measure(angle: float, axis: BoolArray = axis) -> float:
            return fit.estimate_score(replace(few, q=few.q - angle * axis), LEAST_FINE)

        for angle in _find_lowest(measure, as_is, least_fall, ZEROS if is_wide else ()):
            fault = _round_zero(joint, angle, _NOMINAL)
            if abs(fault.factor) >= _LEAST_ANGLE:
                yield fault


def _estimate_scales(motion: Motion, fit: HeldOutFit, *, is_wide: bool) -> Iterator[ColumnFault]:
    """Yield the factors of single joints' positions with which a fit leaves less, by a few rows."""
    few = thin_out(motion, _ROWS)
    moving = find_moving_joints(few)
    as_is, least_fall = fit.estimate_score(few, LEAST_FINE), _PROMISING / max(int(moving.sum()), 1)
    for joint in np.flatnonzero(moving).tolist():

        def measure(log_factor: float, joint: int = joint) -> float:
            return fit.estimate_score(_build_scale(joint, log_factor).mend(few), LEAST_FINE)

        for log_factor in _find_lowest(measure, as_is, least_fall, (-_DOUBLE, _DOUBLE) if is_wide else ()):
            if _LEAST_SCALE <= abs(log_factor) <= _MOST_SCALE:
                yield _build_scale(joint, log_factor)


def _build_scale(joint: int, log_factor: float) -> ColumnFault:
    return ColumnFault("position scaled", (joint,), float(f"{np.exp(log_factor):.4g}"))


def _find_lowest(
    measure: Callable[[float], float], as_is: float, least_fall: float, far: Sequence[float]
) -> Iterator[float]:
    """Yield the values at which a score is lowest, from 0 where it falls beside it, and from the best of others."""
    starts = [0.0] if _estimate_fall(measure(-_BY), as_is, measure(_BY)) >= least_fall else []
    if far:
        lowest = min((measure(value), value) for value in far)
        starts += [lowest[1]] if lowest[0] <= as_is - least_fall else []
    # A start may lead to a valley that is not the deepest one.
    for start in starts:
        yield float(scipy.optimize.minimize_scalar(measure, bracket=(start, start + _BY), options={"xtol": _EXACT}).x)


def _estimate_fall(low: float, middle: float, high: float) -> float:
    """Return how far a logarithm of what is left falls at its lowest point, by three values beside each other."""
    # Squares are a parabola of a small angle, logarithms of them are not.
    low, high = np.exp(2.0 * (low - middle)), np.exp(2.0 * (high - middle))
    bent = low - 2.0 + high
    least = 1.0 - (high - low) ** 2 / (8.0 * bent) if bent > 0.5 * abs(high - low) else min(low, high)
    return float(-0.5 * np.log(np.clip(least, _TINY, 1.0)))


def refine_zero_by_masses(fault: ColumnFault, described: DescriptionFit) -> ColumnFault:
    """Return a joint's zero with which the masses of the description leave least, near a quarter turn.

    Parameters
    ----------
    fault : ColumnFault
        A zero that is a quarter turn, or half a turn, from the description's.
    described : DescriptionFit
        What the description says of the motion.
    """

    def measure(angle: float) -> float:
        left = described.estimate_left(replace(fault, factor=angle))
        return 0.0 if left is None else left

    angle = float(
        scipy.optimize.minimize_scalar(measure, bracket=(fault.factor, fault.factor + _BY), options={"xtol": _EXACT}).x
    )
    return _round_zero(fault.joints[0], angle, _NOMINAL_BY_MASSES)


def _round_zero(joint: int, angle: float, nominal: float) -> ColumnFault:
    """Return the fault of another zero: half a turn at most, and a quarter turn where it is near one."""
    angle = float((angle + np.pi) % (2.0 * np.pi) - np.pi)
    usual = min(ZEROS, key=lambda usual: abs(np.sin(0.5 * (angle - usual))))
    is_usual = 2.0 * abs(np.sin(0.5 * (angle - usual))) < nominal
    return ColumnFault("joint zero", (joint,), usual if is_usual else float(f"{angle:.3g}"))


def describe_zeros(fault: ColumnFault, names: Sequence[str], q: Sequence[str]) -> str:
    """Describe in words that joints have other zeros than in the description.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    names : sequence of str
        Names of its joints.
    q : sequence of str
        What the user calls the columns of positions.
    """
    angles = [f"{np.rad2deg(zero):.0f} degrees ({zero:.3g} rad)" for zero in fault.zeros.values()]
    which = [f"the zero of {name} ({q[joint]})" for name, joint in zip(names, fault.joints, strict=True)]
    if len(which) == 1:
        return f"{which[0]} is not the description's: the column is {angles[0]} where the description has 0"
    return (
        f"{' and '.join(which)} are not the description's: the columns are {' and '.join(angles)} where the "
        "description has 0"
    )


def describe_zeros_cure(fault: ColumnFault) -> tuple[str, tuple[Remedy, ...]]:
    """Say what to state, or to change in the description, where joints have other zeros; with its remedy.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    """
    remedy = Remedy("zeros", list_zeros(fault))
    if len(fault.joints) > 1:
        how = f"State where their zeros are ({remedy}, in rad), or turn the link between them in the description."
    else:
        other = "or, of a last joint, describe a load on this link"
        how = f"State where its zero is ({remedy}, in rad), turn the joint in the description, {other}."
    return how, (remedy,)


def describe_mixing(fault: ColumnFault, names: Sequence[str], q: Sequence[str]) -> str:
    """Describe in words that the columns of two joints are those of the motors of a differential.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    names : sequence of str
        Names of the two joints.
    q : sequence of str
        What the user calls the columns of positions.
    """
    assert fault.mixing is not None
    angles = _list_sums(fault, fault.mixing.matrix, q)
    turned = " and ".join(f"{name} is {angle}" for name, angle in zip(names, angles, strict=True))
    columns = " and ".join(q[joint] for joint in fault.joints)
    return f"{columns} are angles of two motors of a differential or a coupled wrist ({turned})"


def describe_mixing_cure(fault: ColumnFault, q: Sequence[str], tau: Sequence[str]) -> str:
    """Say what the columns of two joints are to be made of, where they are those of coupled motors.

    Parameters
    ----------
    fault : ColumnFault
        The fault.
    q, tau : sequence of str
        What the user calls the columns.
    """
    assert fault.mixing is not None
    formulas = [
        f"{columns[joint]} by {value}"
        for columns, matrix in ((q, fault.mixing.matrix), (tau, fault.mixing.of_torques))
        for joint, value in zip(fault.joints, _list_sums(fault, matrix, columns), strict=True)
        if value != columns[joint]
    ]
    return f"Before the file is read, replace {', '.join(formulas)}, and velocities as positions."


def _list_sums(fault: ColumnFault, matrix: FloatArray, columns: Sequence[str]) -> list[str]:
    """Return each row of a matrix (2, 2) as a sum of the columns of two joints."""
    sums = []
    for row in matrix:
        terms = [
            ("-" if factor < 0 else "+", "" if abs(factor) == 1.0 else f"{abs(factor):g} ", columns[joint])
            for factor, joint in zip(row, fault.joints, strict=True)
            if factor
        ]
        text = " ".join(f"{sign} {size}{column}" for sign, size, column in terms)
        sums.append(text.removeprefix("+ ").replace("- ", "-", 1) if text.startswith("- ") else text.removeprefix("+ "))
    return sums
