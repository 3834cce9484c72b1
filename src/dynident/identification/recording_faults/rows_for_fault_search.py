"""Filter and thin out a recording to the rows that faults are searched on (2,500), and find delays and steps there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, cached_property
from math import floor

import numpy as np

from dynident.array_types import FloatArray, IntArray
from dynident.effects import ANGLE_FRICTION, OFFSETS
from dynident.errors import DynidentError, Remedy
from dynident.identification.recording_faults.column_faults import (
    CubicSpline,
    Delay,
    Motion,
    UnexplainedShares,
    average_share,
    average_shares,
    find_lowest,
    is_possible_delay,
)
from dynident.identification.recording_faults.torque_scale import (
    TorqueScale,
    find_driving_joints,
    find_revolute_joints,
)
from dynident.identification.recording_faults.tree_fit import BLOCKS, find_joints_at_rest, find_moving_joints
from dynident.identification.recording_faults.unexplained_torque import CLEARLY, HeldOutFit, find_joints_with_friction
from dynident.number_format import format_percent
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.recordings.low_pass_decimation import filter_in_parallel
from dynident.recordings.nonparametric_fit import shorten_recording
from dynident.recordings.preprocessing import OVERSAMPLING
from dynident.recordings.recording import SampleBlock
from dynident.recordings.recording_metadata import DELAY, Check, Revision
from dynident.recordings.units import format_time
from dynident.robot.robot_model import Robot

_ROWS = 2500
"""Rows that faults are looked for in: every candidate is fitted to them, so more would take longer and tell little."""

_ROWS_PER_COLUMN = 13
"""Rows for each independent parameter that a fit needs, at least, to tell one order of the columns from another."""

_ROWS_PER_SAMPLE = 0.5 * OVERSAMPLING
"""Rows for each independent sample of a signal below the cut-off."""

_EXPLAINED = 0.2
"""Share left of an average joint's torque, or of the worst joint's, from which on lower cut-offs
are tried: an elastic arm leaves that with the filters of an identification, and half of it with lower ones."""

_CLEARLY, _SURELY = 0.004, 1.5
"""Mean logarithm by which the unexplained share of the torque falls with the delay taken out, and over its standard
error among blocks of time. That a delay cannot be decides more than these do."""

_SHARP = 50.0
"""1/s²: the same fall over the square of the delay, below which a delay costs so little that none is determined. Of
20 ms planted in the open recordings of arms that are rigid it was 96 and more, of a right elastic arm that looked early
30. This is half way between, in logarithms."""

# Delays in s that are tried, closer together near zero; between them a parabola finds the lowest point.
_CANDIDATES = np.array([-0.045, -0.03, -0.02, -0.012, -0.006, 0.0, 0.006, 0.012, 0.02, 0.03, 0.045])
_LONGER = (0.07, 0.1, 0.15, 0.22, 0.3)
"""s: tried one after another where the longest of them explains most, until one explains less."""
_FEW = 8


def estimate_delay(
    motion: Motion,
    period: float,
    left_of: Callable[[Motion], UnexplainedShares],
    left_beside: Callable[[Motion], UnexplainedShares],
) -> Delay | None:
    """Find the delay with which the robot explains most; None where the rows are too few.

    Parameters
    ----------
    motion : Motion
        All filtered rows, in their order.
    period : float
        s between rows.
    left_of : function
        Returns the unexplained shares of a motion's torque.
    left_beside : function
        The same beside constant torques, and friction that depends on the angle where it explains more.

    Returns
    -------
    Delay or None
        The delay, and whether it is a fault; None where the rows are too few.
    """
    if len(motion.q) < _FEW:
        return None
    torque = CubicSpline(motion.tau)

    def shift_torque(seconds: float) -> Motion:
        return replace(motion, tau=torque.read_later(seconds / period))

    tried = {float(seconds): left_of(shift_torque(float(seconds))) for seconds in _CANDIDATES}
    for longer in _LONGER:
        best = min(tried, key=lambda delay: float(tried[delay].fine.mean()))
        if best not in (min(tried), max(tried)):
            break
        tried[float(np.copysign(longer, best))] = left_of(shift_torque(float(np.copysign(longer, best))))
    delays = np.array(sorted(tried))
    unexplained = [tried[float(delay)] for delay in delays]
    held_out, inside = average_shares(unexplained), np.array([trial.fine_inside for trial in unexplained])
    seconds = find_lowest(delays, held_out)
    now, then = tried[0.0], left_of(shift_torque(seconds))
    fall = now.fine - then.fine
    error = float(fall.std(ddof=1)) / np.sqrt(len(fall))
    is_fault = (
        float(fall.mean()) >= _SURELY * error
        and _is_impossible(delays, held_out, seconds)
        and _is_impossible(delays, inside, seconds)
    )
    if is_fault:
        # Tested last, as it needs a second model: made only where all others say yes.
        beside = [left_beside(shift_torque(float(delay))) for delay in delays]
        is_fault = _is_impossible(delays, average_shares(beside), seconds)
        if average_shares(beside).min() < held_out.min():
            # The model that explains more measures the delay.
            seconds = find_lowest(delays, average_shares(beside))
            now, then = beside[int(np.flatnonzero(delays == 0.0)[0])], left_beside(shift_torque(seconds))
    is_at_the_end = seconds in (delays[0], delays[-1])
    return Delay(seconds, is_fault, float(np.exp(now.fine.mean())), float(np.exp(then.fine.mean())), is_at_the_end)


def _is_impossible(delays: FloatArray, unexplained: FloatArray, seconds: float) -> bool:
    """Tell whether the lowest of the shares (delays,) is clear, and at a delay that no drive has.

    On the side of zero that `seconds` are on. Held out, inside the fit and beside other torques alike: in short motions
    one of these alone is chance.
    """
    lowest, as_is = find_lowest(delays, unexplained), float(unexplained[delays == 0.0][0])
    clear = as_is - unexplained.min() >= max(_CLEARLY, _SHARP * lowest**2)
    return bool(clear) and not is_possible_delay(lowest) and (lowest > 0) == (seconds > 0)


class HeldOutFits:
    """Fits of a robot: with its links and friction, and with a constant torque on each joint as well.

    Each is built when it is first needed, and serves all questions about the robot.

    Parameters
    ----------
    robot : Robot
        The robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @cached_property
    def plain_fit(self) -> HeldOutFit:
        """Fit of links and friction."""
        return HeldOutFit(self._robot)

    @cached_property
    def offset_fit(self) -> HeldOutFit:
        """Fit of links, friction and a constant torque on each joint."""
        return HeldOutFit(self._robot, (OFFSETS,))

    @cached_property
    def angle_friction_fit(self) -> HeldOutFit:
        """The same with friction that depends on the joint's angle."""
        if not find_revolute_joints(self._robot).any():
            return self.offset_fit
        return HeldOutFit(self._robot, (OFFSETS, *ANGLE_FRICTION))


def filter_motion(recording: Recording) -> Motion | None:
    """Return filtered rows from all over a recording; None where it is too short to be filtered.

    Parameters
    ----------
    recording : Recording
        The recording.
    """
    whole = filter_whole_motion(recording)
    return None if whole is None else thin_out(whole[0])


def thin_out(motion: Motion, n_rows: int = _ROWS) -> Motion:
    """Return every so many rows of a motion.

    Parameters
    ----------
    motion : Motion
        Filtered rows of the recording.
    n_rows : int
        How many are wanted, by default as many as faults are looked for in; fewer than twice as many are left.
    """
    few, signals = slice(None, None, max(1, len(motion.q) // n_rows)), ("q", "dq", "ddq", "tau", "block", "t")
    return Motion(*(np.ascontiguousarray(getattr(motion, name)[few]) for name in signals))


def filter_whole_motion(recording: Recording, *, octaves: int = 0) -> tuple[Motion, float] | None:
    """Return the filtered rows in their order, and the seconds between them; None where the recording is too short.

    Parameters
    ----------
    recording : Recording
        The recording.
    octaves : int
        How many times the cut-off of an identification is halved. A fault of the columns shows at low frequencies, too,
        while an elastic arm, or one with backlash, has most of what no rigid robot explains above them.
    """
    try:
        choice = choose_preprocessing([recording])
    except DynidentError:
        return None
    return filter_whole_motion_by(choice, recording, octaves=octaves)


def filter_whole_motion_by(
    choice: Preprocessing, recording: Recording, *, octaves: int = 0
) -> tuple[Motion, float] | None:
    """Return the same with filters that were chosen already.

    Parameters
    ----------
    choice : Preprocessing
        The filters of an identification.
    recording : Recording
        The recording.
    octaves : int
        How many times the cut-off is halved.
    """
    cutoff = choice.torque_cutoff
    if octaves and cutoff is not None:
        cutoff /= 2.0**octaves
        choice = replace(choice, decimation=max(1, floor(recording.sampling_rate / (OVERSAMPLING * cutoff))))
    # Positions and torques go through the same filters, so that neither lags. The fits are only compared with each
    # other, so the filters need not be those of an identification.
    choice = replace(choice, position_cutoff=cutoff, torque_cutoff=cutoff)

    def values(block: SampleBlock) -> FloatArray:
        return np.concatenate([block.q, block.dq, block.ddq, block.tau], axis=1)

    # A few minutes tell enough; filtering an hour only takes time.
    short = shorten_recording(recording, choice.decimation)
    parts = [(times, rows) for _, times, rows in filter_in_parallel(short, choice, values) if len(rows)]
    if not parts:
        return None
    t, whole = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    # Blocks of consecutive rows: held out one by one, they test a fit on motion that it has not seen.
    block: IntArray = np.arange(len(whole)) * BLOCKS // len(whole)
    q, dq, ddq, tau = (np.ascontiguousarray(signal) for signal in np.split(whole, 4, axis=1))
    # The noise of joints at rest is no motion: a fit of their links to it would need many rows, and tell nothing.
    still = find_joints_at_rest(dq)
    q[:, still], dq[:, still], ddq[:, still] = np.median(q[:, still], axis=0), 0.0, 0.0
    return Motion(q, dq, ddq, tau, block, t), short.period * choice.decimation


def filter_for_search(recording: Recording, judges: HeldOutFits) -> list[tuple[Motion, float]]:
    """Filter a recording as an identification does, and by octaves narrower where much is unexplained.

    Parameters
    ----------
    recording : Recording
        The recording.
    judges : HeldOutFits
        Fits of the robot.

    Returns
    -------
    list of Motion and float
        Rows in their order, and the seconds between them: first with the cut-off with which least is unexplained, then
        with narrower ones, since a fault of the columns may hide that those would explain more. Empty where the
        recording is too short.
    """
    wide = filter_whole_motion(recording)
    if wide is None:
        return []
    if not has_enough_rows(wide[0], judges.plain_fit):
        return [wide]
    unexplained = judges.plain_fit.measure_unexplained(thin_out(wide[0]))
    if max(unexplained.average_share, unexplained.worst_share) < _EXPLAINED:
        return [wide]
    # What a rigid robot does not explain is mostly at high frequencies: an elastic arm, or backlash. Friction that
    # drives a joint does not count: it tells a wrong sign, and not which rows are explained.
    bands, best, most = [wide], 0, CLEARLY / int(unexplained.moving.sum())
    left = unexplained.average_share
    narrow = filter_whole_motion(recording, octaves=1)
    # Twice as many rows as independent samples: in fewer ones a wrong order may explain as much as the right one.
    while narrow is not None and has_enough_rows(narrow[0], judges.plain_fit, _ROWS_PER_SAMPLE):
        other = judges.plain_fit.measure_unexplained(thin_out(narrow[0]))
        if unexplained.compute_fall_to(other) >= most:
            best, most, left = len(bands), unexplained.compute_fall_to(other), other.average_share
        bands.append(narrow)
        narrow = filter_whole_motion(recording, octaves=len(bands))
    return bands[best:] if left >= _EXPLAINED else [bands[best]]


def drop_scales_of_loads(
    scales: tuple[TorqueScale, ...] | None, motion: Motion, judge: HeldOutFit
) -> tuple[TorqueScale, ...] | None:
    """Return the scales without those of joints whose torques agree with the others' as they are.

    The masses of the description are then wrong for this recording, as with a load on the flange.

    Parameters
    ----------
    scales : tuple of TorqueScale, or None
        Torques that do not match the masses of the description.
    motion : Motion
        Filtered rows of the recording.
    judge : HeldOutFit
        Fit of the robot.
    """
    n = motion.tau.shape[1]
    if not scales or len(scales) == n:
        return scales
    now = judge.measure_unexplained(motion)

    def agrees(scale: TorqueScale) -> bool:
        # Drives of another make are a group: one of them alone, put right, no longer agrees with the others.
        group = {other.joint: 1.0 / other.times for other in scales if other.power == scale.power}
        factors = np.array([group.get(joint, 1.0) for joint in range(n)])
        mended = judge.measure_unexplained(replace(motion, tau=motion.tau * factors))
        return mended.is_surely_above(now, by_friction=False)

    return tuple(scale for scale in scales if scale.by_friction or not agrees(scale))


def report_torque_steps(
    motion: Motion, recording: Recording, tau: Sequence[str], judges: HeldOutFits
) -> tuple[Check, ...]:
    """Report torques that step once and stay so, as where a sensor is zeroed anew during a recording.

    Parameters
    ----------
    motion : Motion
        Filtered rows of the recording.
    recording : Recording
        The recording.
    tau : names
        What the user calls the columns of torques.
    judges : HeldOutFits
        Fits of the robot.
    """
    steps = judges.plain_fit.find_torque_steps(motion)
    if not steps:
        return ()
    largest = max(steps, key=lambda step: step.explained)
    t = float(motion.t[largest.row])
    names = ", ".join(f"{tau[step.joint]} ({recording.joint_names[step.joint]}, by {step.size:.3g})" for step in steps)
    return (
        Check(
            "torque_step",
            "warning",
            f"Torques step once, and stay at the new value: {names}, at about t = {format_time(t)} s. That is "
            f"{format_percent(largest.explained, decimals=0)} of what is unexplained of {tau[largest.joint]}. A sensor "
            "was set to zero again there, a load was picked up or released, or a contact began or ended: use the "
            "seconds on one side alone (windows), or give them as two recordings.",
            tau[largest.joint],
            time=t,
        ),
    )


def has_enough_rows(motion: Motion, judge: HeldOutFit, times: float = 1.0) -> bool:
    """Tell whether there are enough rows to decide anything, and so many times more."""
    return len(thin_out(motion).q) * int(
        find_moving_joints(motion).sum()
    ) >= times * _ROWS_PER_COLUMN * judge.count_columns(motion)


_FARTHEST, _MOST_OF_IT = 5.0, 0.2
"""s, and share of a recording, that the clocks of positions and torques may be apart."""
_NEAR = 0.045
"""s within which drives, elastic arms and single columns that are wrong make a torque look late or early."""
_CLEARLY_LESS = 0.5
"""Share of what is unexplained that may be left with the clocks brought together: of what else is wrong with a
recording, such as columns that are exchanged, another time explains next to nothing."""


def _find_clock_shift(motion: Motion, judge: HeldOutFit) -> float:
    """Return how many s the clock of the torques is ahead of that of the positions; 0 where it is the same.

    Parameters
    ----------
    motion : Motion
        Filtered rows of the recording, in their order.
    judge : HeldOutFit
        Fit of the robot.
    """
    few = thin_out(motion)
    step = float(np.median(np.diff(few.t))) if len(few.t) > 1 else 0.0
    most = int(min(_FARTHEST, _MOST_OF_IT * (few.t[-1] - few.t[0])) / step) if step > 0.0 else 0
    if most * step <= 2.0 * _NEAR or not has_enough_rows(motion, judge):
        return 0.0
    shifts = np.arange(-most, most + 1)
    left = judge.measure_shifted(few, shifts)
    best = int(np.argmin(left))
    is_clear = left[best] <= _CLEARLY_LESS * left[most] and left[best] <= _EXPLAINED
    is_inside = 0 < best < len(shifts) - 1 and abs(shifts[best]) * step > _NEAR
    return float(shifts[best] * step) if is_clear and is_inside else 0.0


def _shift_torques(motion: Motion, seconds: float, period: float) -> Motion:
    """Return the rows that have a torque of so many s later, to whole rows of a period.

    Parameters
    ----------
    motion : Motion
        Filtered rows of the recording, in their order.
    seconds, period : float
        How much later, and between rows.
    """
    rows = round(seconds / period)
    early, late = slice(max(0, -rows), len(motion.q) - max(0, rows)), slice(max(0, rows), len(motion.q) - max(0, -rows))
    q, dq, ddq, t = (np.ascontiguousarray(signal[early]) for signal in (motion.q, motion.dq, motion.ddq, motion.t))
    return Motion(q, dq, ddq, np.ascontiguousarray(motion.tau[late]), np.arange(len(q)) * BLOCKS // len(q), t)


def report_clocks(robot: Robot, motion: Motion, period: float, tau: Sequence[str], judges: HeldOutFits) -> Check | None:
    """Report clocks of positions and torques that are apart; None where they are the same, as far as can be told.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        All filtered rows, in their order.
    period : float
        s between rows.
    tau : names
        What the user calls the columns of torques.
    judges : HeldOutFits
        Fits of the robot.
    """
    seconds = _find_clock_shift(motion, judges.plain_fit)
    if not seconds:
        return None
    rows = round(seconds / period)
    shifted = _shift_torques(motion, seconds, period)
    delay = find_delay(robot, shifted, period, judges)
    if delay is None or delay.is_at_the_end or delay.left_without > _EXPLAINED:
        return None
    seconds = round(rows * period + delay.seconds, 3)
    word, remedy = "late" if seconds > 0 else "early", Remedy(DELAY, seconds)
    left = judges.plain_fit.measure_unexplained(thin_out(motion)).average_share
    return Check(
        DELAY,
        "error" if left > _EXPLAINED else "warning",
        f"The torque is {abs(seconds):.3g} s {word} against the position, as where both were stamped by different "
        f"clocks: the robot's dynamics leave {format_percent(left, decimals=0)} of an average joint's torque "
        f"unexplained, and {format_percent(delay.left_without, decimals=1)} without this delay. Correct it by {remedy} "
        "(in s) for this recording; another one has another delay if the clocks were set in between.",
        tau[0],
        apply=Revision(torque_delay=seconds),
        remedies=(remedy,),
    )


def find_delay(robot: Robot, motion: Motion, period: float, judges: HeldOutFits | None = None) -> Delay | None:
    """Return the delay of the torque of a motion; None where the rows are too few.

    Parameters
    ----------
    robot : Robot
        The robot.
    motion : Motion
        All filtered rows, in their order.
    period : float
        s between rows.
    judges : HeldOutFits, optional
        Those of the robot, if they exist already.
    """
    judges = judges or HeldOutFits(robot)
    judge = judges.plain_fit
    if not has_enough_rows(motion, judge):
        return None

    @cache
    def build_second_fit() -> HeldOutFit:
        # In a sweep the angle tells the speed, so that friction of the angle, or of the load there, looks like a delay.
        fits, few = (judges.offset_fit, judges.angle_friction_fit), thin_out(motion)
        return min(fits, key=lambda fit: average_share(fit.measure_unexplained(few)))

    delay = estimate_delay(
        motion,
        period,
        lambda delayed: judge.measure_unexplained(thin_out(delayed)),
        lambda delayed: build_second_fit().measure_unexplained(thin_out(delayed)),
    )
    if delay is None or not delay.is_fault or find_moving_joints(motion).sum() == 1:
        return delay
    # A log that is late is late for all joints. Where the motors of all others are off, one joint alone may look late
    # by the way in which it breaks loose.
    few = thin_out(motion)
    driven = find_driving_joints(few, surely=False) | find_joints_with_friction(judge.measure_frictions(few))
    return replace(delay, is_fault=bool(driven.sum() > 1))
