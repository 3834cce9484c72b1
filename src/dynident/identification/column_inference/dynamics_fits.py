"""Fit the robot's dynamics to a sample with guessed columns, to confirm or question the guesses.

Holds the fewest rows for a motion (200).

The results become guesses and questions of the proposal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Self

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError, Remedy
from dynident.identification.column_inference.metadata_proposal import Guess, Question
from dynident.identification.identified_models.gravity_from_poses import measure_unexplained_at_rest
from dynident.identification.recording_faults import check_recording_faults
from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.description_fit import DESCRIPTION_CHECKS
from dynident.identification.recording_faults.fault_checks import GRAVITY, SCALE
from dynident.identification.recording_faults.fault_search import MOST_JOINTS
from dynident.identification.recording_faults.joint_angle_faults import ZERO
from dynident.identification.recording_faults.rows_for_fault_search import filter_motion
from dynident.identification.recording_faults.unexplained_torque import HeldOutFit
from dynident.number_format import format_percent
from dynident.recordings import JointLimits, RecordedJoints, Recording, recording_from_arrays
from dynident.recordings.columns_to_signals import NOT_RECORDED
from dynident.recordings.conditioning.signed_registers import check_lost_sign
from dynident.recordings.recording_import import condition_arrays
from dynident.recordings.recording_metadata import COMMANDED, Check
from dynident.recordings.time_columns import RunLabels
from dynident.recordings.units import find_conversion
from dynident.robot import Robot

BORNE_OUT = 0.1
"""Share of the torque that the dynamics may leave unexplained with positions that are taken for the joints'."""

FEWEST_ROWS = 200
"""Rows below which a motion is too short to be filtered and fitted."""

FEWEST_POSES = 10
"""Poses below which gravity is not fitted: a six-axis arm has ten parameters of gravity, and six torques a pose."""


class DynamicsFits:
    """Fits of a robot to the columns of a sample with the times t (m,) in s."""

    def __init__(self, robot: Robot, t: FloatArray, segment: FloatArray | None = None) -> None:
        self.robot = robot
        self._t = t
        self.from_commands = False
        self._last: ReadSignals | None = None
        self._segment = RunLabels().label_rows(0, t) if segment is None else segment.astype(np.int64)

    def select_rows(self, rows: BoolArray) -> Self:
        """Return fits to some rows (m,) of the sample."""
        if rows.all():
            return self
        fits = type(self)(self.robot, self._t[rows], self._segment[rows].astype(np.float64))
        fits.from_commands = self.from_commands
        return fits

    def measure_speed(self, q: FloatArray) -> FloatArray:
        """Return the speed (n,) that positions (m, n) reach in a tenth of a second without break, but for a twentieth.

        Parameters
        ----------
        q : (m, n)
            Positions in any unit.
        """
        period = max(float(np.nanmedian(np.diff(self._t))), 1e-6) if len(self._t) > 1 else 1.0
        step = max(1, int(0.1 / period))
        change, elapsed = np.abs(q[step:] - q[:-step]), self._t[step:] - self._t[:-step]
        follows = np.abs(elapsed / (step * period) - 1.0) < 0.5
        # With a row at rest, as there may be no other.
        speeds = np.vstack([np.zeros(q.shape[1]), change[follows] / elapsed[follows, None]])
        return np.asarray(np.nan_to_num(np.nanpercentile(speeds, 95.0, axis=0)))

    def to_recording(self, q: FloatArray, tau: FloatArray) -> Recording | None:
        """Return the sample as a recording; None where it is too short.

        Parameters
        ----------
        q, tau : (m, n)
            Positions in rad or m, and torques in any unit.
        """
        signals = self.read_signals(q, tau)
        recording = None if signals is None else signals.recording
        return recording and replace(recording, torque_from_commands=self.from_commands)

    def read_signals(self, q: FloatArray, tau: FloatArray) -> ReadSignals | None:
        """Read positions and torques (m, n), unless they were read last: many questions are about the same ones.

        Parameters
        ----------
        q, tau : (m, n)
            Positions in rad or m, and torques in any unit.
        """
        if len(self._t) < FEWEST_ROWS:
            return None
        last = self._last
        if last is None or not all(np.array_equal(*pair, equal_nan=True) for pair in ((last.q, q), (last.tau, tau))):
            last = self._last = ReadSignals(np.array(q), np.array(tau), self._build_recording(q, tau))
        return last

    def _build_recording(self, q: FloatArray, tau: FloatArray) -> Recording | None:
        try:
            q, tau, _ = self.condition_signals(q, tau)
            good = np.isfinite(q).all(axis=1) & np.isfinite(tau).all(axis=1)
            arrays, names = (self._t[good], q[good], tau[good]), self.robot.joint_names
            return recording_from_arrays(*arrays, joint_names=names, segment=self._segment[good])
        except DynidentError:
            return None

    def condition_signals(
        self, q: FloatArray, tau: FloatArray, sources: tuple[Sequence[str], Sequence[str]] | None = None
    ) -> tuple[FloatArray, FloatArray, tuple[Check, ...]]:
        """Correct positions (m, n) in rad or m and torques (m, n) as an import does, and return the checks about it.

        Parameters
        ----------
        q, tau : (m, n)
            Positions and torques.
        sources : pair of sequences of str, optional
            The names of their columns, for the checks.
        """
        limits = [
            JointLimits(joint.kind, joint.limits.position, joint.limits.velocity, joint.limits.effort)
            for joint in self.robot.joints
        ]
        joints = RecordedJoints(self.robot.joint_names, limits)
        return condition_arrays(self._t, q, tau, joints, self._segment, sources)

    def to_motion(self, q: FloatArray, tau: FloatArray) -> Motion | None:
        """Return the filtered rows of positions (m, n) in rad or m and torques (m, n); None where there are too few.

        Parameters
        ----------
        q : (m, n)
            Positions in rad or m.
        tau : (m, n)
            Torques in any unit.
        """
        signals = self.read_signals(q, tau)
        return None if signals is None else signals.motion

    def measure_unexplained(self, q: FloatArray, tau: FloatArray) -> float | None:
        """Return the unexplained share of an average joint's torque; None where it cannot be told.

        Parameters
        ----------
        q, tau : (m, n)
            Positions in rad or m, and torques in any unit.
        """
        return self.measure_with_factors(q, tau, np.ones(q.shape[1]))

    def measure_with_factors(self, q: FloatArray, tau: FloatArray, factors: FloatArray) -> float | None:
        """Return the same with the positions of joints times factors (n,), as in other units: they are filtered once.

        Parameters
        ----------
        q, tau : (m, n)
            Positions in rad or m, and torques in any unit.
        factors : (n,)
            By which the positions are multiplied.
        """
        motion = self.to_motion(q, tau)
        # A sample in which nothing moves explains any torque by constants.
        if motion is None or not len(motion.q) or not (np.ptp(motion.q, axis=0) > 0).any():
            return None
        scaled = replace(motion, q=motion.q * factors, dq=motion.dq * factors, ddq=motion.ddq * factors)
        unexplained = self._fit.measure_unexplained(scaled).average_share
        return unexplained if np.isfinite(unexplained) else None

    @cached_property
    def _fit(self) -> HeldOutFit:
        return HeldOutFit(self.robot)


class NoFits(DynamicsFits):
    """In place of fits of a robot whose base moves: the joints alone do not tell what their torques have to be."""

    def read_signals(self, q: FloatArray, tau: FloatArray) -> None:
        """Return None: there is no motion that can be fitted."""


class PoseFits(NoFits):
    """Fits of a robot to poses at which it stands, a row each."""

    def measure_with_factors(self, q: FloatArray, tau: FloatArray, factors: FloatArray) -> float | None:
        """Return the share of the torque that gravity and constant torques leave; None where rows are too few."""
        good = np.isfinite(q).all(axis=1) & np.isfinite(tau).all(axis=1)
        if good.sum() < FEWEST_POSES:
            return None
        return measure_unexplained_at_rest(self.robot, q[good] * factors, tau[good])


@dataclass(frozen=True, eq=False)
class ReadSignals:
    """Positions and torques (m, n) of a sample as a recording, and its filtered rows."""

    q: FloatArray
    tau: FloatArray
    recording: Recording | None

    @cached_property
    def motion(self) -> Motion | None:
        """Filtered rows; None where there are too few."""
        return None if self.recording is None else filter_motion(self.recording)


_CLEARLY = 1.25
"""Ratio of the unexplained shares above which one unit for all joints is ruled out."""
_FULL = {"rad": 1.0, "deg": 100.0}
"""Ends of a joint's range in files whose positions are shares of it, by the unit that these are mistaken for."""
_SMALL_TURN, _FEW_TURNS, _NO_WORSE = 2.0 * np.pi, 8.0 * np.pi, 1.05
"""Ranges in rad: of what may be an angle, and of wrists. The ratio of what is left up to which a unit is as good."""


def find_units_by_joint(
    fits: DynamicsFits, q: FloatArray, tau: FloatArray, unit: str
) -> tuple[dict[int, str], str, bool] | None:
    """Find units, joint by joint, with which the dynamics explain clearly more than with one for all.

    Some joints may be in rad and others in degrees; or all in shares of each joint's range, -100 to 100.

    Parameters
    ----------
    fits, q, tau : DynamicsFits, (m, n), (m, n)
        Of the sample, as the file has it.
    unit : str
        The one unit that the ranges allow for all joints that turn, "rad" or "deg".

    Returns
    -------
    dict of int to str, str and bool, or None
        The unit of each joint that turns, the reason as a clause, and whether it is of shares.
    """
    turning = [index for index, joint in enumerate(fits.robot.joints) if joint.kind == "revolute"]
    span, most = np.nanmax(q, axis=0) - np.nanmin(q, axis=0), np.nanmax(np.abs(q), axis=0)
    small = [j for j in turning if unit == "deg" and span[j] >= LEAST_TURN and most[j] < _SMALL_TURN]
    full = _FULL[unit]
    limits = {j: fits.robot.joints[j].reach for j in turning}
    may_be_shares = bool(most[turning].max() <= _MORE * full) and all(
        limit is not None and limit[1] > limit[0] for limit in limits.values()
    )
    if not (small or may_be_shares):
        return None

    def measure(units: dict[int, str]) -> float:
        scaled = np.array(q)
        for j, own in units.items():
            factor, offset = find_conversion("q", "revolute", own, f"q{j + 1}")
            scaled[:, j] = scaled[:, j] * factor + offset
        share = fits.measure_unexplained(scaled, tau)
        return 1.0 if share is None else share

    best = dict.fromkeys(turning, unit)
    as_one = measure(best)
    if small and len(small) < len(turning):
        mixed = best | dict.fromkeys(small, "rad")
        share = measure(mixed)
        for j in small if _CLEARLY * share < as_one else ():
            # A joint that moves little may be in degrees all the same.
            if (other := measure(mixed | {j: unit})) < share:
                mixed, share = mixed | {j: unit}, other
        # A wrist that turns on beyond the limits of the description is more common than units of two kinds.
        radians = dict.fromkeys(turning, "rad")
        if span[turning].max() <= _FEW_TURNS and (whole := measure(radians)) <= _NO_WORSE * share:
            mixed, share = radians, whole
        if _CLEARLY * share < as_one:
            reason = f"the robot's dynamics leave {_write_share(share)} of the torque unexplained with these units, "
            return mixed, f"{reason}{_write_share(as_one)} with {unit} for all joints", False
    if may_be_shares:
        shares = {j: _write_share_unit(limit, full) for j, limit in limits.items() if limit is not None}
        least = measure(shares)
        if _CLEARLY * least < as_one:
            reason = (
                f"as {unit} the robot's dynamics leave {_write_share(as_one)} of the torque unexplained, as shares of "
                f"each joint's range ({-full:g} to {full:g} between its limits in the description) "
                f"{_write_share(least)}. If the ranges of the calibration are others, state counts per turn by these"
            )
            return shares, reason, True
    return None


_SCALES, _ROUNDS, _LEAST_STEP, _HARDLY_LESS, _OTHER = 12, 30, 0.04, 0.95, 1.5
"""Scales that are tried for all joints; rounds in which that of each is changed, and the logarithm to which it is
found; the ratio of what is left that is no progress; and the ratio to one unit for all joints from which on a joint has
another: gears and encoders of one arm differ by more, if they do."""


def find_scales_by_joint(
    fits: DynamicsFits, q: FloatArray, tau: FloatArray, unit: str
) -> tuple[dict[int, str], str, bool] | None:
    """Estimate counts per turn of each joint, where one unit does not explain the torque and counts of their own do.

    Parameters and result are those of `find_units_by_joint`.
    """
    turning = np.array([joint.kind == "revolute" for joint in fits.robot.joints])
    factor, offset = find_conversion("q", "revolute", unit, "q")
    stated = np.where(turning, q * factor + offset, q)
    scales, span = np.zeros(len(turning)), float(np.nanmax(np.ptp(stated[:, turning], axis=0)))
    if len(turning) > MOST_JOINTS or not 0.0 < span < np.inf:  # each trial is a fit: too many of longer chains
        return None

    def measure(logarithms: FloatArray) -> float:
        share = fits.measure_with_factors(stated, tau, np.where(turning, np.exp(logarithms), 1.0))
        return 1.0 if share is None else share

    as_one = least = measure(scales)
    are_counts = unit.startswith("counts:")  # any encoder and gear give such, and friction explains wrists with all
    if as_one < BORNE_OUT and not are_counts:
        return None
    for common in np.log(np.geomspace(LEAST_TURN / span, 4.0 * np.pi / span, _SCALES)):
        if (share := measure(np.full(len(turning), common))) < least:
            scales, least = np.full(len(turning), common), share
    if _CLEARLY * least > as_one and not are_counts:
        return None
    step = first = np.log(_OTHER)
    for _ in range(_ROUNDS):
        before = least
        for joint, side in product(np.flatnonzero(turning), (step, -step)):
            tried = scales + side * (np.arange(len(turning)) == joint)
            if (share := measure(tried)) < least:
                scales, least = tried, share
        # Where the first steps do not help, something else is wrong.
        if step < _LEAST_STEP or (step == first and least > _HARDLY_LESS * as_one):
            break
        step *= 0.5 if least > _HARDLY_LESS * before else 1.0
    if _CLEARLY * least > as_one:
        return None
    counts = [float(f"{2.0 * np.pi / factor / np.exp(scale):.3g}") for scale in scales]
    steps = first * np.eye(len(turning))  # scales of joints that carry little change nothing: they are not determined
    known = [measure(scales + change) + measure(scales - change) > 2.0 * least / _HARDLY_LESS for change in steps]
    zero = f"@{-offset / factor:.10g}" if offset else ""  # the middle of all scales
    units = {int(joint): f"counts:{counts[joint]:.10g}{zero}" for joint in np.flatnonzero(turning & known)}
    has_others = np.abs(scales[turning & known]).max(initial=0.0) >= first
    is_sure = are_counts or (least < BORNE_OUT and not has_wrong_columns(fits, stated, tau))
    reason = (
        f"as {unit} the robot's dynamics leave {_write_share(as_one)} of the torque unexplained, and "
        f"{_write_share(least)} with counts per turn of its own for each joint, as where gears or encoders differ. The "
        "numbers are estimates: look up the exact ones, and those of other joints: gear ratio times counts per turn"
    )
    return (units, reason, True) if has_others and is_sure else None


def has_wrong_columns(fits: DynamicsFits, q: FloatArray, tau: FloatArray) -> bool:
    """Tell whether a fault of the columns, such as an angle from the horizon, or their order, explains the torque.

    Scales of all joints imitate it, and with it motion and gravity may seem to explain nothing.

    Parameters
    ----------
    fits : DynamicsFits
        Of the sample.
    q, tau : (m, n)
        Positions in rad or m, and torques.
    """
    recording, names = fits.to_recording(q, tau), fits.robot.joint_names
    faults = () if recording is None else check_recording_faults(fits.robot, recording, names, names).checks
    return any(fault.status == "error" and fault.name not in _FIELDS for fault in faults)


def _write_share(share: float) -> str:
    return format_percent(share, decimals=0)


def _write_share_unit(limits: tuple[float, float], full: float) -> str:
    """Return the unit of positions that are `full` at the upper limit, and the opposite at the lower one."""
    factor, middle = (limits[1] - limits[0]) / (2.0 * full), 0.5 * (limits[0] + limits[1])
    zero = -middle / factor
    return f"counts:{2.0 * np.pi / factor:.4f}" + (f"@{zero:.4f}" if abs(zero) > 0.0 else "")


_MORE = 1.01
LEAST_TURN = 0.06
"""rad: what an angle in rad moves by at least, where it moves."""

_UNEXPLAINED_LIMIT = 0.5
"""Unexplained share of an average joint's torque above which the columns are taken for wrong."""

_MUCH = 0.1
"""Unexplained share of an average joint's torque that a position which was not recorded may be the cause of."""

_ASKED_WARNINGS = (GRAVITY, SCALE, ZERO)
"""Checks that are asked about although they only warn: what they find makes a model useless."""

_FIELDS = {GRAVITY: "gravity", SCALE: "units/tau", COMMANDED: "effort_kind", ZERO: "zeros"}
"""Fields of the metadata, or of the robot, that checks are about; all other checks are about the columns."""


def check_against_dynamics(
    robot: Robot,
    fits: DynamicsFits,
    q: FloatArray,
    tau: FloatArray,
    names: tuple[Sequence[str], Sequence[str]],
    *,
    in_si: bool,
    silent: Sequence[int] = (),
) -> tuple[list[Guess], list[Question]]:
    """Check columns against a robot's dynamics as the import of the whole file will.

    What that would refuse is asked now.

    Parameters
    ----------
    robot : Robot
        As it was given.
    fits : DynamicsFits
        Of the sample.
    q, tau : (m, n)
        Positions in rad or m; torques, in N m or N where that is known, which `in_si` says.
    names : pair of names
        Of the columns of positions, and of torques.
    in_si : bool
        Whether the torques are in N m or N.
    silent : sequence of int
        Joints whose torque was not recorded, which is said elsewhere.

    Returns
    -------
    tuple of guesses and questions
    """
    own = np.flatnonzero(np.ptp(tau, axis=0) > 0.0).tolist()
    if lost := check_lost_sign(tau[:, own], [names[1][joint] for joint in own]):
        return [], [Question.from_check("columns", lost)]  # whatever else does not fit is its consequence
    recording = fits.to_recording(q, tau)
    examined = None if recording is None else check_recording_faults(robot, recording, *names)
    # Where the unit is not known yet, the size of the torques says nothing; it is asked with the unit.
    wrong = [] if examined is None else [check for check in examined.checks if _is_finding(check, in_si=in_si)]
    questions = [
        Question.from_check(_FIELDS.get(check.name, "columns"), check) for check in wrong if _is_question(check)
    ]
    guesses = [
        Guess("check", check.name.replace("_", " "), 0.5, check.detail, check.remedies)
        for check in wrong
        if not _is_question(check)
    ]
    is_commanded = any(check.name == COMMANDED for check in wrong)
    # A torque that never changes while its joint moves was not recorded.
    still = np.setdiff1d(np.flatnonzero((np.ptp(tau, axis=0) == 0) & (np.ptp(q, axis=0) > 0)), silent)
    if len(still) and not is_commanded:
        remedy = Remedy("columns", {f"tau{int(still[0]) + 1}": NOT_RECORDED})
        never = ", ".join(names[1][int(joint)] for joint in still)
        questions.append(
            Question(
                "columns/tau",
                f"{never} never change while the joints move: where is the measured torque? If it was not recorded, "
                f"state {remedy}, or lock the joint.",
                remedies=(remedy,),
            )
        )
    if examined is None or examined.unexplained is None:
        nothing = "too little motion, or times that are not in order: the robot's dynamics cannot check the columns"
        if robot.n > MOST_JOINTS:
            nothing = f"a robot of more than {MOST_JOINTS} joints: friction alone checks them, when the file is read"
        return [*guesses, *([] if is_commanded else [Guess("check", "none", 0.5, nothing)])], questions
    worst = int(np.argmax((unexplained := examined.unexplained).joints))
    reason = (
        "share of the torque that the robot's dynamics do not explain, as the mean over the joints; for "
        f"{robot.joint_names[worst]} {format_percent(unexplained.worst_share, decimals=0)}"
    )
    # The masses of the description explain no residual: identification does not use them.
    causes = [check for check in wrong if check.name not in DESCRIPTION_CHECKS]
    stuck = np.flatnonzero(np.ptp(q, axis=0) == 0.0)
    # What noise leaves, which goes to and fro from row to row, says nothing of a joint that stands.
    rest = unexplained.joints[worst] * np.sqrt(np.mean(tau[:, worst] ** 2))
    is_noise = np.median(np.abs(np.diff(tau[:, worst], 2))) > rest
    if len(stuck) and not causes and unexplained.average_share > _MUCH and not is_noise:
        never = ", ".join(f"{names[0][joint]} ({robot.joint_names[joint]})" for joint in map(int, stuck))
        reason += (
            f"; {never} never changes: if it moved, its position was not recorded, and without it the motion of the "
            "links behind it is not known. Record it, or leave the joint out (lock) if it stood"
        )
        share = f"{format_percent(unexplained.average_share, decimals=0)} unexplained"
        return [Guess("check", share, 0.4, reason), *guesses], questions
    if unexplained.average_share < _UNEXPLAINED_LIMIT and not causes:
        return [
            *guesses,
            Guess("check", f"{format_percent(unexplained.average_share, decimals=0)} unexplained", 0.9, reason),
        ], questions
    # The most probable cause comes first, before all other guesses.
    cause, remedies = (f"; most probably: {causes[0].detail}", causes[0].remedies) if causes else ("", ())
    share = f"{format_percent(unexplained.average_share, decimals=0)} unexplained"
    return [Guess("check", share, 0.4, f"{reason}{cause}", remedies), *guesses], questions


def _is_finding(check: Check, *, in_si: bool) -> bool:
    return check.status != "ok" and (in_si or check.name != SCALE)


def _is_question(check: Check) -> bool:
    return check.status == "error" or check.name in _ASKED_WARNINGS
