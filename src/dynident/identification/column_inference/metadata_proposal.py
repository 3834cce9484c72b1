"""Types of a proposal: guesses with their certainty and reason, questions with their choices."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.errors import Remedy
from dynident.identification.column_inference.column_names import ColumnName, find_waves
from dynident.recordings.joint_phases import STANDS
from dynident.recordings.position_checks import MOVED
from dynident.recordings.recording_metadata import COMMANDED, Check, EffortKind
from dynident.recordings.units import JOINT_KINDS
from dynident.robot import Robot


@dataclass(frozen=True)
class Guess:
    """One guess about a file.

    Parameters
    ----------
    field : str
        Field of the metadata that it is about, such as "columns/q".
    value : str
        The proposed value.
    confidence : float
        From 0 to 1.
    reason : str
        The reason, as a clause.
    remedies : tuple of Remedy
        Those that the reason quotes.
    """

    field: str
    value: str
    confidence: float
    reason: str
    remedies: tuple[Remedy, ...] = ()


NO_MASSES = (
    "the description has none, so that nothing tells torques from currents, or shows torques of a wrong size or "
    "without gravity: state what was recorded, or validate the model with a known load"
)
"""What cannot be checked of a robot whose description has no masses."""

SURE = 0.8
"""Confidence below which a unit has to be confirmed."""


@dataclass(frozen=True)
class UnitGuess:
    """A guess of a unit.

    Parameters
    ----------
    unit : str
        The unit.
    confidence : float
        From 0 to 1; below `SURE` the unit has to be confirmed.
    reason : str
        The reason, as a clause.
    choices : tuple of str
        Units to choose from, if any.
    """

    unit: str
    confidence: float
    reason: str
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Question:
    """A question that has to be answered before the file can be used.

    Parameters
    ----------
    field : str
        Field of the metadata that it is about.
    detail : str
        The question.
    choices : tuple of str
        Answers that make sense; none where any may be right.
    check : str
        Name of the check that asks, if one does: to accept it is an answer, too.
    remedies : tuple of Remedy
        Those that the question quotes.
    is_curable : bool
        Whether the check proposes a correction of the file.
    """

    field: str
    detail: str
    choices: tuple[str, ...] = ()
    check: str = ""
    remedies: tuple[Remedy, ...] = ()
    is_curable: bool = False

    @property
    def is_about_meaning(self) -> bool:
        """Whether it asks how columns of joints are to be read: files of one logger have one answer.

        What no choice answers, such as a refusal, is a fact of the one file, and so is what its clock did.
        """
        kind = self.field.removeprefix("columns/").removeprefix("units/").rstrip("0123456789")
        return bool(self.choices) and not self.check and kind in ("effort_kind", *JOINT_KINDS)

    @classmethod
    def from_check(cls, field: str, check: Check) -> Question:
        """Ask about what a check has found, in its words."""
        is_curable = check.apply is not None
        return cls(field, check.detail, check=check.name, remedies=check.remedies, is_curable=is_curable)


def is_duty(words: Sequence[str]) -> bool:
    """Return whether the words of a column's name say that it is the duty of a motor's PWM."""
    return not {"pwm", "duty", "dutycycle"}.isdisjoint(words)


def ask_for_kind(names: str, words: Sequence[str]) -> Question:
    """Ask what efforts are.

    Parameters
    ----------
    names : str
        Names of their columns.
    words : sequence of str
        The words of one of these.
    """
    if is_duty(words):
        detail = (
            f"{names} are duties of the motors' PWM: a share of the supply voltage, and no torque. If no current was "
            "recorded, they can stand for one, with drive gains in N m per unit of these numbers at standstill. The "
            "viscous friction then contains the back-EMF of the motors, and a supply voltage that changes is in the "
            "error: where it was recorded, multiply them by it before."
        )
        return Question("effort_kind", detail, ("motor_current",))
    detail = f"What are {names}: torques of the joints, or currents of the motors?"
    return Question("effort_kind", detail, ("joint_torque", "motor_torque", "motor_current"))


@dataclass(frozen=True)
class Proposal:
    """Proposed metadata of a file.

    Parameters
    ----------
    columns : mapping of str to str
        Our names of columns to the file's, as `RecordingMetadata` takes them.
    units : mapping of str to str
        Units by kind of signal, or by column.
    effort_kind : str
        What the efforts are: torques of joints or motors, currents, commands, …
    guesses : tuple of Guess
        The guesses with their reasons.
    questions : tuple of Question
        Questions that are open.
    """

    columns: Mapping[str, str]
    units: Mapping[str, str]
    effort_kind: EffortKind
    guesses: tuple[Guess, ...]
    questions: tuple[Question, ...]

    @property
    def is_sure(self) -> bool:
        """Whether the proposal can be used as it is."""
        return not self.questions


def ask_to_lock(why: str, places: Mapping[str, float]) -> Question:
    """Ask to lock joints at their places (rad, m).

    Parameters
    ----------
    why : str
        What says that they do not move, as a clause.
    places : mapping of str to float
        By joint.
    """
    remedy = Remedy("locked_joints", places)
    return Question("robot", f"{why}: lock {'them' if len(places) > 1 else 'it'}, {remedy}.", remedies=(remedy,))


_AT_ZERO, _MOST = 1e-3, 2.0 * np.pi
"""rad or m: a locked joint's position below the first is 0; one above the second is no angle in radians."""


def ask_to_lock_still_joints(robot: Robot, positions: FloatArray, joints: Sequence[int]) -> Question | None:
    """Ask to lock those of some joints without torque that stand still: a gripper, or a fixed axis; None of others."""
    still = [joint for joint in joints if np.ptp(positions[:, joint]) <= MOVED[robot.joints[joint].kind]]
    middles = {robot.joint_names[joint]: float(np.median(positions[:, joint])) for joint in still}
    places = {name: float(f"{at:.4g}") if _AT_ZERO < abs(at) < _MOST else 0.0 for name, at in middles.items()}
    verbs = "stand still and have" if len(places) > 1 else "stands still and has"
    return ask_to_lock(f"{', '.join(places)} {verbs} no torque", places) if places else None


def describe_further_joints(named: Sequence[ColumnName], n: int, signals: Collection[str]) -> str:
    """Describe columns that are counted beyond the robot's n joints, as where a gripper is recorded with them.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.
    n : int
        Number of the robot's joints.
    signals : collection of str
        Those of which the columns are preferred.

    Returns
    -------
    str
        A sentence with a space before it; "" where there are none.
    """
    counted: dict[tuple[str, ...], list[ColumnName]] = {}
    for column in named:
        if len(column.numbers) == 1:
            counted.setdefault(tuple(word for word in column.words if not word.isdecimal()), []).append(column)
    for members in sorted(counted.values(), key=lambda own: (own[0].signal not in signals, own[0].rank)):
        numbers = sorted(column.numbers[0] for column in members)
        is_counted = numbers == list(range(numbers[0], numbers[0] + len(members))) and numbers[0] in (0, 1)
        is_other = members[0].signal not in (None, *signals)
        if is_other or not is_counted or len(members) <= n:
            continue
        joints = "1 joint" if n == 1 else f"{n} joints"
        return (
            f" {members[0].name} … {members[-1].name} are {len(members)} columns, but the robot has {joints}: which "
            "columns belong to the joints?"
        )
    return ""


def describe_unknown_signals(unknown: Sequence[str], signal: str) -> str:
    """Say which columns of all joints may be a signal that was not recognised; or that there are none.

    Parameters
    ----------
    unknown : sequence of str
        What the user calls the columns of all joints whose names do not say what they are.
    signal : str
        What was not recognised.

    Returns
    -------
    str
        A sentence with a space before it.
    """
    if not unknown:
        return f" No further columns stand for all joints: was the {signal} recorded?"
    return f" Names of columns for all joints that do not say what they are: {'; '.join(unknown[:3])}."


def describe_constant_columns(names: str, values: FloatArray) -> str:
    """Say that columns never change.

    Parameters
    ----------
    names : str
        What the user calls them.
    values : (m, n)
        Their values; NaN where there is no number.

    Returns
    -------
    str
        A sentence.
    """
    return f"{names} have {'one value each in all rows' if np.isfinite(values).any() else 'no number in any row'}."


def describe_single_joint(named: Sequence[ColumnName], n: int, signals: Collection[str]) -> str:
    """Describe the only column of a signal, which does not say of which of the robot's n joints it is.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.
    n : int
        Number of the robot's joints.
    signals : collection of str
        Those of which the column may be.

    Returns
    -------
    str
        A sentence with a space before it; "" where there is none, or several.
    """
    own = (column for column in named if column.signal in signals and not _OF_NO_JOINT & set(column.words))
    measured = [column.name for column in own if column.rank < COMMANDED_RANK]
    if n == 1 or len(measured) != 1:
        return ""
    return (
        f" {measured[0]} is of one joint, but the robot has {n}: if the others stood still, lock them, and say which "
        "joint it is."
    )


_OF_NO_JOINT = frozenset({"robot", "tool", "total", "main", "supply"})
"""Words of the current of the whole robot, as UR's actual_robot_current, and of what it carries."""

COMMANDED_RANK = 4
"""Rank of a column from which on its name says that it is a command."""


def describe_waves(named: Sequence[ColumnName]) -> str:
    """Describe columns that are sines and cosines of angles, as benchmarks of learning have them.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.

    Returns
    -------
    str
        A sentence with a space before it; "" where there are none.
    """
    waves = [column.name for column in find_waves(named)]
    if not waves:
        return ""
    return (
        f" {', '.join(waves[:4])}, … are sines and cosines: write the angles, "
        "numpy.unwrap(numpy.arctan2(sin, cos), axis=0)."
    )


_TURNS = (1.0, 2.0 * np.pi, 360.0, 400.0, 2000.0 * np.pi)
"""A turn in units of angles: positions that wrap there, or after half of it, are made continuous as they are read."""
_JUMP, _STEP, _FEWEST_WRAPS, _LIKE = 0.9, 0.1, 2, 0.02
"""Shares of its range that a counter jumps by at least, and moves otherwise at most; how often; how near a turn is."""


def ask_to_unwrap(names: str, q: FloatArray) -> list[Question]:
    """Ask to make positions (m, n) continuous that begin again where no turn ends, as a counter does."""
    for x in q.T:
        steps, span = np.diff(x), float(np.ptp(x))
        jumps = np.flatnonzero(np.abs(steps) > _JUMP * span)
        others = np.delete(np.abs(steps), jumps)
        if len(jumps) < _FEWEST_WRAPS or not len(others) or others.max() > _STEP * span or (x == np.rint(x)).all():
            continue
        # In a jump the joint goes on as before it: what jumps from rest is a step.
        before = steps[np.maximum(jumps - 1, 0)]
        period = float(f"{np.median(np.abs(steps[jumps] - before)):.3g}")
        # What always jumps the same way is swept again and again, as a grid of poses is.
        is_swept = len({*np.sign(steps[jumps])}) < 2
        is_turn = any(abs(period / turn / half - 1.0) < _LIKE for turn in _TURNS for half in (0.5, 1.0))
        goes_on = (before * steps[jumps] < 0.0) & (np.abs(before) <= _STEP * span)
        if is_turn or is_swept or goes_on.mean() < 0.5:
            continue
        detail = (
            f"{names} jump by {period:g}, {len(jumps)} times, from one end of their range to the other: a counter "
            f"begins again there. Make them continuous, numpy.unwrap(q, period={period:g}, axis=0)."
        )
        return [Question("columns/q", detail)]
    return []


def describe_unused_columns(named: Sequence[ColumnName], columns: Mapping[str, str], n: int) -> list[Guess]:
    """Describe columns that are left out where all of a robot's n joints have theirs in `columns`.

    They are of joints that it lacks, or further signals of its own: angles of the motors beside those of joints.
    """
    if f"q{n}" not in columns or not {"tau1", "current1"} & set(columns):
        return []
    used = set(columns.values())
    # The time is that of no joint; velocities that are not used have told why.
    signals = {column.signal for column in named if column.name in used} & {"q", "dq", "tau", "current", "effort"}
    known = {word for column in named if column.name in used for word in column.words}
    strange = [column for column in named if column.signal in signals and column.rank < 4 and column.name not in used]
    strange = [column for column in strange if not set(column.words) <= known]
    places = {(column.signal, _get_number(column)) for column in named if column.name in used}
    further = [column.name for column in strange if (column.signal, _get_number(column)) in places]
    others = [column.name for column in strange if column.name not in further]
    reasons = ((further, "a second set of signals of the same joints"), (others, "by name of no joint of the robot"))
    return [Guess("columns", ", ".join(names), 0.8, f"not used: {reason}") for names, reason in reasons if names]


def _get_number(column: ColumnName) -> tuple[str, ...]:
    return tuple(word for word in column.words if word.isdecimal()) or column.words


def describe_still_joints(names: Sequence[str], q: FloatArray) -> list[Guess]:
    """Say which joints stand still in all rows of q (m, n): a fit of this recording alone needs them locked."""
    still = {names[k]: float(q[:, k].mean()) for k in np.flatnonzero(np.ptp(q, axis=0) <= STANDS).tolist()}
    if not 0 < len(still) < len(names):
        return []
    lock = Remedy("locked_joints", {name: float(f"{place:.4g}") for name, place in still.items()})
    reason = f"it does not move in these rows: if no other recording moves it, {lock}"
    return [Guess("robot", f"{', '.join(still)} at rest", 0.9, reason, (lock,))]


def ask_for_unit_of_time(name: str, unit: str, rate: float) -> Question:
    """Ask for the unit of a time that does not state one, by the rate in Hz that follows from the guessed one."""
    remedy = Remedy("rate")
    detail = (
        f"In which unit is {name}? In {unit} the rows come at {rate:.4g} Hz; if that is wrong, so is what the torques "
        f"seem to be in. If {name} counts ticks of a clock, state the rows' rate: {remedy}."
    )
    return Question("units/t", detail, ("s", "ms", "us", "ns"), remedies=(remedy,))


def name_further_efforts(questions: Sequence[Question], names: Sequence[str]) -> list[Question]:
    """Name the columns that may hold a measured torque in the question about one that a controller computed."""
    others = f" It may be in {'; '.join(names)}." if names else ""
    return [replace(each, detail=f"{each.detail}{others}") if each.check == COMMANDED else each for each in questions]


def read_effort_kind(signal: str | None, named: ColumnName, rank: int) -> EffortKind:
    """Return what the names of effort columns, and their rank among such names, say; "unknown" where nothing."""
    if signal == "q":
        return "position_command"
    if named.external:
        return "external"
    if named.compensated:
        return "gravity_compensated"
    return "commanded" if rank >= 4 else "unknown"


def report_silent_torques(name: str, columns: Sequence[str]) -> Guess:
    """Say that torques of 0 are set aside for commands, and how to keep them: the motors may have been off.

    Parameters
    ----------
    name : str
        What the user calls the columns together.
    columns : sequence of str
        The column of every joint.
    """
    remedies = (
        Remedy("columns", {f"tau{joint + 1}": column for joint, column in enumerate(columns)}),
        Remedy("effort_kind", "joint_torque"),
        Remedy("accept", ("constant_torque",)),
    )
    instead = ", ".join(map(str, remedies))
    reason = f"set aside, they are 0 in every row; if the robot swung with its motors off, state {instead}"
    return Guess("columns/tau", name, 0.5, reason, remedies)


_FOLLOWS, _SAME_TURN, _MOST_TURNS = 0.999, 1.5, 500.0
"""Squared correlation of a motor's position with its joint's, which an elastic gear leaves; the ratio of both below
which they are positions of the same side; and the one above which a motor's are counts, or in another unit."""

_SAME_UNIT = 2e-3
"""Share by which a ratio may be off a multiple of the degrees in a radian."""


def describe_gear_ratios(names: Sequence[str], sides: Sequence[tuple[str, FloatArray]]) -> list[Guess]:
    """Propose gear ratios where positions of motors are recorded beside those of the joints: one is a multiple.

    Only of joints that move, and whose motor follows them alone: one of a coupled wrist follows two.

    Parameters
    ----------
    names : sequence of str
        Those of the n joints.
    sides : sequence of str and (m, n)
        What the user calls columns together, and their values: of the joints, and then of motors.
    """
    guesses = []
    (joints, links), *others = sides
    for name, motors in others:
        both = [values - values.mean(axis=0) for values in (links, motors)]
        squares, product = [(values**2).sum(axis=0) for values in both], (both[0] * both[1]).sum(axis=0)
        follows = (np.ptp(links, axis=0) > 0.0) & (product**2 >= _FOLLOWS * squares[0] * squares[1])
        ratios = np.divide(product, squares[0], out=np.zeros(len(names)), where=follows)
        geared = np.flatnonzero(np.abs(ratios) > _SAME_TURN).tolist()
        degrees = np.abs(np.deg2rad(ratios[geared]))
        is_in_degrees = (np.abs(degrees - np.maximum(np.rint(degrees), 1.0)) <= _SAME_UNIT * degrees).all()
        if is_in_degrees or np.abs(ratios).max() > _MOST_TURNS:
            continue
        reason = f"{name} are so many times {joints}; of positions in one unit these are the gear ratios"
        value = ", ".join(f"{names[joint]}: {ratios[joint]:.4g}" for joint in geared)
        guesses.append(Guess("drives", value, 0.8, reason))
    return guesses
