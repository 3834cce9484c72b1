"""Guess the time column; notice files that are to be transposed, and poses at rest instead of a motion.

Holds from how many columns on a file seems to be written on its side (200).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import Remedy
from dynident.identification.column_inference import unit_inference as of_units
from dynident.identification.column_inference.column_groups import ColumnGroup
from dynident.identification.column_inference.column_statistics import (
    CLOCK_FACTORS,
    Clock,
    ask_for_rate_of_bursts,
    find_changing_columns,
    find_clock_columns,
    is_counter,
    read_clock,
)
from dynident.identification.column_inference.dynamics_fits import FEWEST_ROWS, DynamicsFits, PoseFits
from dynident.identification.column_inference.metadata_proposal import Question
from dynident.identification.column_inference.proposal_in_progress import WorkingProposal
from dynident.identification.robot_recording_import import build_recorded_joints
from dynident.number_format import format_percent
from dynident.recordings.base_motion import QUATERNION, find_base_columns, find_reactions
from dynident.recordings.columns_to_signals import NOT_RECORDED
from dynident.recordings.file_source import find_bursts
from dynident.recordings.pose_recordings import are_poses
from dynident.recordings.recording_metadata import EffortKind, RecordingError, RecordingMetadata
from dynident.recordings.sampling_clock import GAP_PERIODS, LONGEST_PERIOD
from dynident.recordings.signal_spectra import fill_gaps, find_rate_by_slopes
from dynident.recordings.time_columns import is_time_name
from dynident.robot import Robot
from dynident.robot.pinocchio_conversion import compute_described_torque

_EXPLAINED = 0.5
"""Share of the torque that gravity may leave unexplained where the columns hold what their names say."""

_MOST_COLUMNS = 200
"""Columns beyond which, if the rows are fewer, each row is a signal: twelve joints of a dozen signals have 150."""

TOGETHER = "give the files as one recording (q.csv+dq.csv+tau.csv)"


def guess_clock(work: WorkingProposal) -> Clock | None:
    """Find the column of the time; ask where no column runs as a clock, or none for sure.

    Parameters
    ----------
    work : WorkingProposal
        Gets the column, its unit, and a question where it is not sure.

    Returns
    -------
    Clock or None
        None where no column runs as a clock.
    """
    names, values = work.sample.names, work.sample.values
    running = find_clock_columns(values) if len(values) > 2 else []
    clocks = [
        clock for column in running if (clock := read_clock(values, column, work.column_names[column].unit)) is not None
    ]
    by_name = [clock for clock in clocks if work.column_names[clock.column].signal == "t"]
    # A column that is called a time and counts rows, or often goes back, is a weaker clock than another.
    by_name.sort(key=lambda clock: (is_counter(values, clock.column), _often_goes_back(values[:, clock.column])))
    even = [
        clock
        for clock in clocks
        if not is_counter(values, clock.column) or work.column_names[clock.column].signal == "t"
    ]
    # A column with the name of a time first; then one that runs evenly; a row counter only where nothing else does.
    choice = next(iter(by_name or even or clocks), None)
    if choice is None:
        backward = [names[column] for column in find_clock_columns(values[::-1]) if is_time_name(names[column])]
        if backward:
            remedy = Remedy("rate")
            order = (
                f"{backward[0]} runs backward: the rows are in reverse order, or it counts down. Write the earliest "
                f"row first; of a time that counts down, state the rate of the rows instead: {remedy}."
            )
            work.questions.append(Question("columns/t", order, remedies=(remedy,)))
            return None
        unsorted = [index for index, name in enumerate(work.column_names) if name.signal == "t"]
        if unsorted and (order := _describe_disorder(names[unsorted[0]], values, unsorted[0])):
            work.add_question("columns/t", order)
            return None
        # More columns than rows, each row of one signal: what a matrix gives that is written as it lies in memory.
        if len(names) > _MOST_COLUMNS and len(values) < len(names):
            lying = f"The file has {len(names)} columns and {len(values)} rows of numbers: it seems that each row is a"
            lying += " signal. Write one row for each moment, with a column for each signal (transpose the file)."
            work.add_question("columns/t", lying)
            return None
        if (coarse := _ask_for_rate(work)) is not None:
            work.questions.append(coarse)
            return None
        missing = "No column looks like a clock: which column is the time, and in which unit? If the file has no time,"
        detail = f"{missing} give the rate of its rows in Hz (rate). If the time is in another file, {TOGETHER}."
        remedies = tuple(Remedy("rate", rate) for rate in [find_rate_by_slopes(values)] if rate)
        detail += f" As the derivatives of other columns, velocities say: {remedies[0]}." if remedies else ""
        work.questions.append(Question("columns/t", detail, names, remedies=remedies))
        return None
    name = names[choice.column]
    if name not in work.sample.stated and (bursts := ask_for_rate_of_bursts(name, values, choice)):
        work.questions.append(bursts)
        return None
    sure = choice.sure and bool(by_name or even)
    # A counter of rows gives an order but no rate.
    if not by_name and is_counter(values, choice.column):
        sure = False
    work.columns["t"] = name
    if choice.unit != "s":
        work.units["t"] = choice.unit
    reason = "its name, and " if by_name else "it increases evenly; "
    work.add_guess(
        "columns/t",
        name,
        0.98 if sure else 0.5,
        f"{reason}{choice.reason}; jitter {format_percent(choice.jitter, decimals=1)}",
    )
    if not sure:
        detail = f"Is {name} the time, in {choice.unit}? {choice.reason}."
        if is_counter(values, choice.column):
            detail += " It counts rows: if these are no times, give the rate of the rows in Hz (rate)."
        work.add_question("units/t", detail, ("s", "ms", "us", "ns"))
    return choice


def _often_goes_back(t: FloatArray) -> bool:
    """Return whether a time goes back as one does that a busy receiver wrote; a few restarts are none of that."""
    return bool(np.mean(np.diff(t) < 0.0) > _RARELY)


_RARELY = 1e-3
"""Share of the steps of a time that go back where runs follow one another."""


def _describe_disorder(name: str, values: FloatArray, column: int) -> str:
    """Return what to say of a time that goes forward mostly, and back here and there; "" of others."""
    t = values[:, column]
    steps = np.diff(t)
    back = np.flatnonzero(steps < 0)
    if not len(back) or np.mean(steps > 0) < _MOSTLY:
        return ""
    # Positions are smooth in the order in which they were recorded, whatever the times say.
    others = np.delete(values, column, axis=1)
    rough = [np.abs(np.diff(rows, 2, axis=0)).sum(axis=0) for rows in (others, others[np.argsort(t, kind="stable")])]
    is_shuffled = np.count_nonzero(rough[1] < rough[0]) > np.count_nonzero(rough[1] > rough[0])
    cure = "Sort the rows by time." if is_shuffled else "Do not sort them: give the rate of the rows in Hz (rate)."
    wrong = "the rows are not in the order of their times" if is_shuffled else "its values are wrong, not the rows"
    return f"{name} goes back in {len(back)} rows, the first is row {back[0] + 2}: {wrong}. {cure}"


_MOSTLY = 0.6
"""Share of the steps of a time that go forward."""


def _ask_for_rate(work: WorkingProposal) -> Question | None:
    """Ask for the rate of rows whose clock is called a time but stands still for rows, or is uneven; None of others."""
    for column, name in enumerate(work.column_names):
        t = work.sample.values[:, column]
        steps = np.diff(t)
        if name.signal != "t" or len(t) <= 2 or not np.isfinite(t).all() or (steps < 0).any():
            continue
        ticks = np.flatnonzero(steps > 0) + 1
        if len(ticks) < _FEWEST_TICKS:
            return _ask_for_rate_of_even_rows(
                f"{name.name} is the same in nearly all rows: it has too few digits, as seconds since 1970 have with "
                "32 bits."
            )
        unit, middle = name.unit or "s", float(np.median(steps))
        factor = CLOCK_FACTORS.get(unit, 1.0)
        if len(ticks) > _MOST_TICKED * len(t):
            short, long = np.quantile(steps, [0.1, 0.9])
            others = np.delete(work.sample.values, column, axis=1)
            repeated = float(np.mean((others[1:] == others[:-1]).all(axis=1)))
            twice = f", and {format_percent(repeated, decimals=0)} of the rows repeat the row before: leave these out"
            ends = np.flatnonzero(steps > GAP_PERIODS * middle)
            return _ask_for_rate_of_even_rows(
                f"{name.name} goes forward by {short:.3g} to {long:.3g} {unit} from row to row, too unevenly for a "
                f"clock{twice if repeated > _MANY_REPEATED else ''}.",
                (find_bursts(ends, t[ends], middle)[1] or 1.0 / steps.mean()) / factor,
            )
        # Between the first and the last change every row is counted once.
        rate = (ticks[-1] - ticks[0]) / ((t[ticks[-1]] - t[ticks[0]]) * factor)
        return _ask_for_rate_of_even_rows(
            f"{name.name} stays the same for {(ticks[-1] - ticks[0]) / (len(ticks) - 1):.2g} rows at a time: it is too "
            f"coarse to say when each row was recorded. On average these are {rate:.4g} rows a second (with "
            f"{name.name} in {unit}).",
            rate,
        )
    return None


def _ask_for_rate_of_even_rows(why: str, rate: float | None = None) -> Question:
    remedy = Remedy("rate") if rate is None else Remedy("rate", float(f"{rate:.4g}"))
    why += f" If the rows are evenly spaced, state their rate: {remedy}."
    return Question("columns/t", why, remedies=(remedy,))


_FEWEST_TICKS, _MOST_TICKED = 4, 0.9
"""Changes of a coarse clock by which the rate of the rows is told; and the share of rows at which it may change."""

_MANY_REPEATED = 0.2
"""Share of the rows that repeat the row before, as where two programs write one file."""


def are_columns_poses(work: WorkingProposal) -> bool:
    """Tell whether the columns called positions jump from row to row, and no time says that rows are close together."""
    names, values = work.column_names, fill_gaps(work.sample.values)
    positions = [k for k, name in enumerate(names) if name.signal == "q"]
    clocks = {*find_clock_columns(values), *(k for k, name in enumerate(names) if name.signal == "t")} - set(positions)
    periods = (CLOCK_FACTORS.get(names[k].unit or "s", 1.0) * float(np.median(np.diff(values[:, k]))) for k in clocks)
    jump = len(positions) >= work.robot.n and are_poses(values[:, positions])
    return jump and min(periods, default=np.inf) > LONGEST_PERIOD


def guess_clock_of_poses(work: WorkingProposal) -> Clock | None:
    """Return the time column of rows that are poses, whose steps are no sampling period."""
    values = work.sample.values
    called = [k for k, name in enumerate(work.column_names) if name.signal == "t"]
    column = next(iter(called or [k for k in find_clock_columns(values) if is_counter(values, k)]), None)
    if column is None:
        work.add_question("columns/t", "Which column is the time, or counts the poses?", work.sample.names)
        return None
    unit = work.column_names[column].unit or "s"
    steps = np.diff(values[:, column])
    # A nominal rate, only so that the rows have an order; no filter uses it.
    middle = float(np.median(steps[steps > 0])) if (steps > 0).any() else 1.0
    work.columns["t"] = work.sample.names[column]
    if unit != "s":
        work.units["t"] = unit
    known = "its name" if called else "it counts the rows"
    reason = f"{known}; positions jump from row to row, {middle:.3g} {unit} apart: poses at rest, one per row"
    work.add_guess("columns/t", work.sample.names[column], 0.95, reason)
    return Clock(column, unit, CLOCK_FACTORS.get(unit, 1.0), 1.0 / middle, 0.0, True, reason)


def guess_efforts_at_poses(
    work: WorkingProposal,
    fits: DynamicsFits | PoseFits,
    tau: FloatArray,
    effort: ColumnGroup,
    q: FloatArray | None,
    kind: EffortKind,
) -> EffortKind:
    """Take the efforts for what their names say, and report what gravity leaves of them.

    Parameters
    ----------
    work : WorkingProposal
        Gets the columns, their unit, and what gravity leaves of them.
    fits : DynamicsFits or PoseFits
        Fits of the robot to the sample.
    tau : (m, n)
        Efforts as the file has them.
    effort : ColumnGroup
        Their columns.
    q : (m, n) or None
        Positions in rad or m; None where they are not known.
    kind : str
        What the efforts' names say, or "unknown".

    Returns
    -------
    str
        What they are taken for.
    """
    signal = "current" if effort.signal == "current" else "tau"
    if signal == "current" and kind == "unknown":
        kind = "motor_current"
    elif kind == "unknown":
        kind = "joint_torque"
    work.add_guess("effort_kind", kind, 0.8, "by its name; a robot at standstill gives no more evidence")
    work.assign_columns(signal, effort)
    gains = [drive.gain for drive in work.robot.drives]
    if signal == "current":
        guess = of_units.guess_current_unit(tau, gains, work.robot, effort.unit)
    else:
        guess = of_units.guess_torque_unit(work.robot, tau, effort.unit, of_units.compute_reach(work.robot))
    work.take_effort_unit(signal, guess, effort)
    unexplained = None if q is None else fits.measure_unexplained(q, tau)
    if unexplained is not None:
        reason = "share of the torque at rest that gravity and constant torques do not explain"
        work.add_guess(
            "check",
            f"{format_percent(unexplained, decimals=0)} unexplained",
            0.9 if unexplained < _EXPLAINED else 0.4,
            reason,
        )
    return kind


_LARGEST_ROBOT = 50.0
"""m."""
_LENGTHS = (("mm", 1e-3), ("cm", 1e-2), ("inches", 0.0254))
"""Units in which lengths of descriptions are written, and their m."""
_SHORTEST = 1.0
"""s: below it nothing is told by the dynamics."""
_ALL_ROWS = 1 << 14
"""Rows from which on a sample may be the beginning of a longer file."""


def ask_about_file(work: WorkingProposal) -> bool:
    """Ask about a file without numbers, or a robot of another size; return whether there is such a question."""
    values = work.sample.values
    reach = of_units.compute_reach(work.robot)
    if not len(values):
        work.add_question("columns", "The file names its columns but has no row below: nothing was recorded.")
    elif not np.isfinite(values).any():
        detail = (
            "No cell of the file is a number. Write a table: a line of names, then a row for each moment, with the "
            "same separator between all numbers."
        )
        work.add_question("columns", detail)
    elif reach > _LARGEST_ROBOT:
        fitting = [f"in {unit} {reach * size:.2g} m" for unit, size in _LENGTHS if reach * size < _LARGEST_ROBOT / 5.0]
        detail = (
            f"By its description the robot would reach {reach:.0f} m: lengths are in m, and these are in another unit. "
            f"It would reach {' or '.join(fitting)}. Write the lengths in the description in m."
        )
        work.add_question("robot", detail)
    return bool(work.questions)


def ask_about_length(work: WorkingProposal, clock: Clock) -> None:
    """Ask whether a recording of less than a second is meant: nothing is told by so little motion."""
    rows = len(work.sample.values)
    # Where rows come in bursts their usual step says nothing of the whole.
    steps = np.diff(work.t[np.isfinite(work.t)])
    seconds = max(rows / clock.rate, float(steps[steps > 0.0].sum()))
    if are_columns_poses(work) or seconds >= _SHORTEST or rows >= _ALL_ROWS:
        return
    detail = (
        f"The recording has {seconds:.2g} s, too little to tell one parameter from another, or a measured "
        "torque from a commanded one: record 10 s or more."
    )
    work.questions.append(Question("rows", detail, check="length"))


_OTHER_TIME, _SAME_GRAVITY = 5.0, 5.0
"""Ratio of rates from which on a time has another unit: rotors behind gears make inertia up to ten times larger, which
is three times in time; and what the load of gravity agrees to meanwhile."""


def ask_about_time(work: WorkingProposal, fits: DynamicsFits, clock: Clock, q: FloatArray, tau: FloatArray) -> None:
    """Ask for the unit of a time that does not state one, where gravity agrees with the description and inertia not.

    A fit does not tell it: masses that are free make up for any scale of time.

    Parameters
    ----------
    work : WorkingProposal
        Gets the question.
    fits : DynamicsFits
        Of the sample.
    clock : Clock
        The time as it was guessed.
    q, tau : (m, n)
        Positions in rad or m, and torques in N m or N.
    """
    name, robot = work.sample.names[clock.column], work.robot
    if work.column_names[clock.column].unit or clock.unit == "s" or robot.inertias is None:
        return
    motion = fits.to_motion(q, tau)
    if motion is None or len(motion.q) < FEWEST_ROWS:
        return
    states = [signal[:: max(1, len(motion.q) // _STATES)] for signal in (motion.q, motion.dq, motion.ddq)]
    measured, still = motion.tau[:: max(1, len(motion.q) // _STATES)], np.zeros_like(states[0])
    gravity = compute_described_torque(robot, states[0], still, still)
    inertia = compute_described_torque(robot, *states) - gravity
    # Friction and offset of each joint are free; noise of small joints must not count as that of large ones.
    rows = []
    for joint in range(robot.n):
        speed = states[1][:, joint]
        free = np.column_stack([speed, np.sign(speed), np.ones(len(speed))])
        three = np.column_stack([gravity[:, joint], inertia[:, joint], measured[:, joint]])
        rest = three - free @ np.linalg.lstsq(free, three, rcond=1e-10)[0]
        rows.append(rest / (rest[:, 2].std() + 1e-12))
    both, right = np.split(np.concatenate(rows), [2], axis=1)
    size = np.sqrt((both**2).sum(axis=0)) + 1e-30
    of_gravity, of_inertia = np.linalg.lstsq(both / size, right[:, 0], rcond=1e-10)[0] / size
    if not 1.0 / _SAME_GRAVITY < of_gravity < _SAME_GRAVITY or of_inertia <= 0.0:
        return
    ratio = float(np.sqrt(of_inertia / of_gravity))
    if 1.0 / _OTHER_TIME < ratio < _OTHER_TIME:
        return
    remedy = Remedy("rate")
    detail = (
        f"In which unit is {name}? In {clock.unit} the rows would come at {clock.rate:.4g} Hz, and the torque would "
        f"hold {of_inertia:.2g} times the inertia of the description beside its gravity: with about "
        f"{float(f'{clock.rate * ratio:.2g}'):g} Hz both agree. If {name} counts ticks of a clock, state the "
        f"rate of the rows: {remedy}."
    )
    work.add_question("units/t", detail, ("s", "ms", "us", "ns"))
    work.questions[-1] = replace(work.questions[-1], remedies=(remedy,))


_STATES = 400
"""Rows that are compared with the description."""


def drop_dependent_questions(work: WorkingProposal) -> None:
    """Drop what follows from a clock that is in doubt, or from too few rows: these are asked first."""
    if any(question.field == "units/t" for question in work.questions):
        of_rate = [question for question in work.questions if question.check == "clock_rate"]
        work.questions = of_rate or [
            question
            for question in work.questions
            if not question.check and question.field not in ("effort_kind", "units/tau")
        ]
        work.guesses = [guess for guess in work.guesses if guess.field != "check"]
    if any(question.check == "length" for question in work.questions):
        work.questions = [question for question in work.questions if question.field != "effort_kind"]


def find_segment_column(work: WorkingProposal) -> FloatArray | None:
    """Return the column (m,) that numbers the runs, and assign it; None where there is none."""
    for index, name in enumerate(work.column_names):
        # A label of runs is a whole number that stays for many rows.
        values = work.sample.values[:, index]
        if name.signal != "segment" or not np.isfinite(values).all() or (values != np.rint(values)).any():
            continue
        if len(np.unique(values)) < max(2, len(values) // 20):
            work.columns["segment"] = name.name
            work.add_guess("columns/segment", name.name, 0.9, "whole numbers that stay constant for long: segments")
            return np.asarray(values)
    return None


def report_empty_columns(work: WorkingProposal) -> None:
    """Report which columns hold no numbers at all."""
    empty = np.flatnonzero(~np.isfinite(work.sample.values).any(axis=0)) if len(work.sample.values) else ()
    if len(empty):
        names = ", ".join(work.sample.names[column] for column in empty)
        work.add_guess("columns", names, 0.9, "not used: their cells are no plain numbers")


def add_base_columns(work: WorkingProposal, robot: Robot) -> None:
    """Take the columns of a moving base's pose, and of wrenches on links, by their names; ask for what is missing.

    Parameters
    ----------
    work : WorkingProposal
        Gets the columns, or questions.
    robot : Robot
        The robot, whose base moves.
    """
    names, nothing_stated = work.sample.names, RecordingMetadata()
    # Nothing was compared with the dynamics, however long the recording is.
    work.guesses = [guess for guess in work.guesses if guess.field != "check"]
    joints = build_recorded_joints(robot)
    pose = find_base_columns(names, nothing_stated, joints)
    angles = [name for name in ("base_yaw", "base_pitch", "base_roll") if name in robot.joint_names[: robot.n_base]]
    if pose:
        work.columns |= {ours: source for ours, source in pose.items() if ours != source}
        work.add_guess("columns/base_qx", ", ".join(pose.values()), 0.9, "the pose of the base, by their names")
    has_angles = all(name in names or f"q_{name}" in names for name in angles)
    if not has_angles and not all(name in pose for name in QUATERNION):
        detail = (
            "The base of this robot moves: which columns are its orientation? Name those of its unit quaternion, "
            f"{', '.join(QUATERNION)}, or of its angles in rad, {', '.join(angles)}."
        )
        work.add_question("columns/base_qx", detail, names)
    try:
        reactions = find_reactions(names, joints, nothing_stated)
    except RecordingError as error:
        work.add_question("columns", error.detail)
        return
    links = ", ".join(f"{reaction.link} ({'world' if reaction.in_world else 'link'} frame)" for reaction in reactions)
    reason, remedies = "forces of the surroundings on links, by the names of the columns", tuple[Remedy, ...]()
    if robot.contacts:
        links = ", ".join(contact.link for contact in robot.contacts)
        reason = "eliminated, as you say of these contacts"
    elif not reactions:
        links, remedies = "none", (Remedy("contacts"),)
        reason = "no columns are <link>_fx … <link>_mz: the file is read as that of a robot that nothing touches; name "
        reason += f"feet on the ground by {remedies[0]}"
    work.add_guess("columns/wrenches", links, 0.9, reason, remedies)
    if not reactions or any(ours.startswith(("tau", "current")) for ours in work.columns):
        return
    # A person or a position-controlled robot on force plates: the joints' own equations are left out.
    not_recorded = {f"tau{k + 1}": NOT_RECORDED for k in range(work.robot.n)}
    used = {*work.columns.values(), *pose.values(), *(c.source for reaction in reactions for c in reaction.columns)}
    moving = zip(work.column_names, find_changing_columns(work.sample.values), strict=True)
    others = [name for name, moves in moving if moves and name.name not in used]
    if sum(name.signal in (None, "tau", "current", "effort") for name in others) < work.robot.n:
        work.questions = [question for question in work.questions if question.field != "columns/tau"]
        work.columns |= not_recorded
        work.add_guess("columns/tau", NOT_RECORDED, 0.9, "the forces on links suffice for the base's equations")
        return
    remedy = Remedy("columns", not_recorded)
    for k, question in enumerate(work.questions):
        if question.field == "columns/tau":
            detail = f"{question.detail} If no torque was recorded, state {remedy}."
            work.questions[k] = replace(question, detail=detail, remedies=(*question.remedies, remedy))
