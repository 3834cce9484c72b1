"""Group a file's columns by signal, one column a joint; find joints that lack a column, and duplicates."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace

from dynident.array_types import BoolArray, FloatArray
from dynident.identification.column_inference.column_names import (
    PENDANTS,
    ColumnName,
    Signal,
    find_phrase,
    find_words_of_all,
    list_spellings_by_joint,
    strip_shared_words,
)
from dynident.identification.column_inference.column_statistics import compute_roughness
from dynident.identification.column_inference.metadata_proposal import Question, ask_to_lock, ask_to_lock_still_joints
from dynident.number_format import format_percent
from dynident.recordings.units import get_signal_of_unit
from dynident.robot import Robot

_Stems = dict[tuple[str, ...], dict[int, int]]
"""Columns by their names without the joint, and by the joint or its number."""
_Reasons = dict[tuple[str, ...], str]
_POSITIONS: tuple[Signal, ...] = ("q",)
_EFFORTS: tuple[Signal, ...] = ("tau", "current", "effort")


def ask_for_missing_joints(named: Sequence[ColumnName], robot: Robot) -> Question | None:
    """Ask to lock joints that have no column at all; None where the positions are not those of most joints."""
    positions = _find_columns_of_most_joints(named, robot, _POSITIONS)
    if positions is None:
        return None
    names = [name for joint, name in enumerate(robot.joint_names) if joint not in positions[1]]
    why = f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} in the robot, but not in the file"
    return ask_to_lock(why, dict.fromkeys(names, 0))


def find_torque_of_most_joints(
    named: Sequence[ColumnName], robot: Robot, positions: FloatArray, empty: int
) -> ColumnGroup | Question | None:
    """Return the torques that most joints have; a question where a joint without torque stands still.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.
    robot : Robot
        The robot.
    positions : (m, n)
        Of all joints, in any unit.
    empty : int
        The column that is put in the place of missing torques.

    Returns
    -------
    ColumnGroup, Question or None
        None where there are no such torques.
    """
    torques = _find_columns_of_most_joints(named, robot, _EFFORTS)
    if torques is None:
        return None
    first, columns = torques
    columns = columns | _find_forces_of_sliding_joints(named, robot, columns)
    question = ask_to_lock_still_joints(robot, positions, [k for k in range(robot.n) if k not in columns])
    if question is not None:
        return question
    members = tuple(columns.get(joint, empty) for joint in range(robot.n))
    return ColumnGroup(
        members, first.signal, first.unit, first.rank, first, "by their names they belong to most joints"
    )


def _find_forces_of_sliding_joints(
    named: Sequence[ColumnName], robot: Robot, columns: Mapping[int, int]
) -> dict[int, int]:
    """Return the columns of sliding joints that are counted or named as the torques are, and called forces."""
    called = {index: other for index, other in enumerate(named) if _FORCES & set(other.words)}
    hits = {index: _match_joint_name(other.words, robot.joint_names) for index, other in called.items()}
    forces = {hit[0]: index for index, hit in hits.items() if hit is not None and hit[0] not in columns}
    joint, column = next(iter(columns.items()))
    if len(named[column].numbers) == 1:
        numbers = {named[column].numbers[0] - joint + k: k for k in range(robot.n) if k not in columns}
        forces |= {
            numbers[other.numbers[0]]: index
            for index, other in called.items()
            if len(other.numbers) == 1 and other.numbers[0] in numbers
        }
    return {joint: index for joint, index in forces.items() if robot.joints[joint].kind == "prismatic"}


def _find_columns_of_most_joints(
    named: Sequence[ColumnName], robot: Robot, signals: Collection[Signal]
) -> tuple[ColumnName, dict[int, int]] | None:
    """Return the columns, by joint, of the most likely of some signals."""
    groups = [group for group in find_incomplete_groups(named, robot.joint_names) if group[0].signal in signals]
    measured = [group for group in groups if group[0].rank < 4]
    return min(measured, key=lambda group: (group[0].rank, group[0].signal != "tau"), default=None)


_NOISE = 1.0
"""Roughness from which on a position is noise: at rest it is 2.4, and of a motion of 0.5 Hz, logged at 4 Hz, 0.6."""


def select_axes_in_use(groups: Sequence[ColumnGroup], values: FloatArray) -> list[ColumnGroup]:
    """Return the groups that move, where a number alone tells their names apart: of several drives one is in use."""
    stems = {tuple(word for word in group.named.words if not word.isdecimal()) for group in groups}
    # Units of other axes may differ, and sizes say nothing. What stands still is noise, or has one value or none.
    rough = [compute_roughness(values[:, list(group.columns)]) for group in groups]
    in_use = [group for group, size in zip(groups, rough, strict=True) if ((size > 0.0) & (size < _NOISE)).any()]
    return in_use if len(stems) == 1 and in_use else list(groups)


_LETTERS = "xyz"
_SIGNALS = ("q", "dq", "ddq", "tau", "current", "effort", "temperature")
_LENGTHS = ("m", "mm", "cm")
_FORCES = frozenset({"f", "force", "kraft", "forces"})


def group_few_joints(named: Sequence[ColumnName], rest: Sequence[int], robot: Robot) -> list[ColumnGroup]:
    """Group columns that belong to the only joint, or by their letters to axes that all slide.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.
    rest : sequence of int
        The columns that belong to no group yet.
    robot : Robot
        The robot.

    Returns
    -------
    list of ColumnGroup
        Groups with one column for each joint.
    """
    slides = all(joint.kind == "prismatic" for joint in robot.joints)
    signals = {index: _get_signal(named[index], slides=slides) for index in rest}
    if robot.n == 1:
        return [
            ColumnGroup((index,), signal, named[index].unit, named[index].rank, named[index], "the robot has one joint")
            for index, signal in signals.items()
            if signal is not None
        ]
    if not slides or robot.n > len(_LETTERS):
        return []
    members: dict[tuple[Signal, int], dict[str, int]] = {}
    for index, signal in signals.items():
        letter = _get_axis_letter(named[index])
        if signal is not None and letter:
            members.setdefault((signal, named[index].rank), {}).setdefault(letter, index)
    groups = []
    for (signal, rank), places in members.items():
        # Letters count as axes only where every joint has its column.
        if len(places) == robot.n:
            columns = tuple(places[letter] for letter in sorted(places))
            reason = "the axes are named by letters, in order"
            groups.append(ColumnGroup(columns, signal, named[columns[0]].unit, rank, named[columns[0]], reason))
    return groups


def _get_axis_letter(column: ColumnName) -> str:
    """Return the axis that a name is of: the only word that is x, y or z, or the last letter of a force, fx."""
    letters = [word[-1] for word in column.words if word in _LETTERS or word[:-1] in _FORCES]
    return letters[0] if len(letters) == 1 and letters[0] in _LETTERS else ""


def _get_signal(column: ColumnName, *, slides: bool) -> Signal | None:
    """Return the signal that a name says, with forces and lengths where the axes slide."""
    if column.signal in _SIGNALS:
        return column.signal
    if not slides or column.signal not in (None, "other"):
        return None
    if any(word in _FORCES or (word[:-1] in _FORCES and word[-1] in _LETTERS) for word in column.words):
        return "tau"
    if column.unit == "N":
        return "tau"
    is_length = column.unit in _LENGTHS or (
        column.unit is None and column.words in tuple((letter,) for letter in _LETTERS)
    )
    return "q" if is_length and column.signal is None else None


EXPLAINED = 0.3
"""Largest unexplained share of the torque for positions that nothing else identifies: wrong ones leave far more."""

_OURS: tuple[Signal, ...] = ("q", "dq", "ddq", "tau", "current", "temperature")
"""Kinds of signals that are read by their own names."""


@dataclass(frozen=True)
class ColumnGroup:
    """Columns of one signal, in the robot's order of joints.

    Parameters
    ----------
    columns : tuple of int
        Numbers of the columns.
    signal : str or None
        The signal; None where the names do not say.
    unit : str or None
        Unit that the names state.
    rank : int
        Rank of the worst of its columns: the lower, the more it is the measured signal.
    named : ColumnName
        What the first column's name says.
    reason : str
        How the group is known, as a clause.
    """

    columns: tuple[int, ...]
    signal: Signal | None
    unit: str | None
    rank: int
    named: ColumnName
    reason: str

    def renumber(self, places: list[int]) -> ColumnGroup:
        """Return the same group where its columns are at these places of all columns."""
        return replace(self, columns=tuple(places[index] for index in self.columns))


def group_columns(
    named: Sequence[ColumnName],
    joint_names: Sequence[str],
    followers: Sequence[str] = (),
    alive: BoolArray | None = None,
    links: Sequence[str] = (),
    clocks: Collection[int] = (),
    described: Sequence[str] = (),
) -> tuple[list[ColumnGroup], list[int], list[int]]:
    """Group columns that differ by the joint alone.

    Parameters
    ----------
    named : sequence of ColumnName
        What the names of all columns say.
    joint_names, followers : sequence of str
        Joints that are driven, and those that follow them.
    alive : (columns,) of bool, optional
        Which columns hold changing numbers: those counted behind the last joint that do not are empty places.
    links : sequence of str
        Links that the joints move, by joint: some viewers name columns by them.
    clocks : collection of int
        Columns that run forward evenly: counted before the joints they are none.
    described : sequence of str
        All joints of the description: those that are locked may be counted in the file.

    Returns
    -------
    groups, rest, following : list of ColumnGroup, columns (by index) that belong to none, and those of `followers`
    """
    ours = _group_by_own_names(named, joint_names)
    in_ours = {index for group in ours for index in group.columns}
    following: list[int] = []
    by_stem, reasons = _Stems(), _Reasons()
    stems_of_parts: set[tuple[str, ...]] = set()
    # Where no column has a whole name, the words that all names begin with may be missing, or be others.
    is_whole = any(_match_joint_name(column.words, joint_names) for column in named)
    spoken = (*(joint_names if is_whole else strip_shared_words(joint_names)), *followers)
    for index, column in enumerate(named):
        if index in in_ours:
            continue
        hit, reason = _match_joint_name(column.words, spoken), "the joint name"
        if hit is not None and not is_whole:
            stems_of_parts.add(hit[1])
        elif hit is None and all(links):
            hit, reason = _match_joint_name(column.words, links), "the name of the link that the joint moves"
        if hit is not None and hit[0] >= len(joint_names):
            following.append(index)
        elif hit is not None:
            joint, stem = hit
            by_stem.setdefault(stem, {}).setdefault(joint, index)
            reasons[stem] = f"the column name contains {reason}"
    # Names of all joints or none: a stem that some joints lack, and its columns, are left to the numbers.
    by_stem = {stem: group for stem, group in by_stem.items() if len(group) == len(joint_names)}
    used = {index for group in by_stem.values() for index in group.values()} | in_ours | set(following)
    joints = [joint_names.index(name) if name in joint_names else None for name in described or joint_names]
    numbered, why, of_locked = _group_by_number(named, used, joints, alive, clocks)
    by_stem |= numbered
    reasons |= why
    used = {index for group in by_stem.values() for index in group.values()} | in_ours | {*following, *of_locked}
    groups, counted, shortened = ours, list[ColumnGroup](), list[ColumnGroup]()
    for stem, group in by_stem.items():
        columns = tuple(group[joint] for joint in range(len(joint_names)))
        built = _build_group(columns, named, reasons[stem])
        (counted if stem in numbered else shortened if stem in stems_of_parts else groups).append(built)
    # Another arm in the same file counts its joints alike, but has not their names, or not a word of all, as "left".
    groups += [b for b in counted if not _is_of_other_joints(b, groups, counted, find_words_of_all(joint_names))]
    # What is left of a name may be the axis of another device, roll or x: other columns of the same signal are meant.
    groups += [built for built in shortened if not any(_is_same_signal(built, group) for group in groups)]
    return groups, [index for index in range(len(named)) if index not in used], following


def _is_same_signal(built: ColumnGroup, group: ColumnGroup) -> bool:
    """Tell whether a group measures the same signal, or another form of effort, at least as directly."""
    alike = {built.signal, group.signal}
    return group.rank <= built.rank and built.signal is not None and (len(alike) == 1 or alike <= {*_EFFORTS})


def _is_of_other_joints(
    built: ColumnGroup, groups: Sequence[ColumnGroup], counted: Sequence[ColumnGroup], shared: frozenset[str]
) -> bool:
    """Tell whether counted columns have words that those with the joints' names lack, or left for all joints' right."""
    own = set(built.named.words)
    alike = [other for other in (*groups, *counted) if other.signal == built.signal is not None]
    words = [(set(other.named.words), other in groups) for other in alike if other.rank <= built.rank]
    gaps = [(own - other, other - own, is_named) for other, is_named in words]
    return any(lost if is_named else len(lost) == len(new) == 1 and new <= shared for lost, new, is_named in gaps)


def _group_by_own_names(named: Sequence[ColumnName], joint_names: Sequence[str]) -> list[ColumnGroup]:
    """Group columns that have the names of a stored recording: q_<joint>, whatever the joints are called."""
    places = {name.name: index for index, name in enumerate(named)}
    groups = []
    for signal in _OURS:
        columns = [places.get(f"{signal}_{joint}") for joint in joint_names]
        known = tuple(column for column in columns if column is not None)
        if len(known) == len(joint_names):
            own = _build_group(known, named, "they have the standard column names")
            groups.append(replace(own, signal=signal, rank=-1))
    return groups


def find_incomplete_groups(
    named: Sequence[ColumnName], joint_names: Sequence[str]
) -> list[tuple[ColumnName, dict[int, int]]]:
    """Return the first name and the columns by joint of each signal that most joints have, but not all."""
    n = len(joint_names)
    by_stem, numbered = _Stems(), _Stems()
    ours = {f"{kind}_{name}": joint for joint, name in enumerate(joint_names) for kind in ("tau", "q")}
    for index, column in enumerate(named):
        own = ours.get(column.name)
        hit = _match_joint_name(column.words, joint_names)
        if own is not None:
            by_stem.setdefault(("ours", column.signal or ""), {}).setdefault(own, index)
        elif hit is not None:
            by_stem.setdefault(hit[1], {}).setdefault(hit[0], index)
        elif len(column.numbers) == 1:
            stem = tuple("#" if word.isdecimal() else word for word in column.words)
            numbered.setdefault(stem, {}).setdefault(column.numbers[0], index)
    for stem, members in numbered.items():
        # Joints are counted from 0 or from 1; not beside more that are not counted.
        first = 0 if 0 in members else 1
        if _count_other_joints(named) < len(members):
            by_stem[stem] = {number - first: index for number, index in members.items() if number - first < n}
    # Of numbers only most say that joints are meant, or that efforts have them, too; names say it for as few as two.
    groups = [(stem, named[next(iter(each.values()))], each) for stem, each in by_stem.items() if each]
    places = [{frozenset(g[2]) for g in groups if g[1].signal in kinds} for kinds in (_POSITIONS, _EFFORTS)]
    return [
        (first, members)
        for stem, first, members in groups
        if (n / 2 if stem in numbered and frozenset(members) not in places[0] & places[1] else 1) < len(members) < n
    ]


def infer_by_elimination(
    groups: Sequence[ColumnGroup],
    whole: Sequence[ColumnGroup],
    unexplained: Callable[[tuple[int, ...], tuple[int, ...]], float],
) -> list[ColumnGroup]:
    """Return the one group of `whole` that must be the missing torque, or the missing positions.

    Parameters
    ----------
    groups, whole : sequence of ColumnGroup
        Those with a signal, and those without.
    unexplained : function
        Returns the share of torques that the motion of positions leaves, given the columns of both.
    """
    ranked = sorted(whole, key=lambda group: group.rank)
    if not ranked or (len(ranked) > 1 and ranked[1].rank == ranked[0].rank):
        return []
    only, have = ranked[0], {group.signal for group in groups}
    efforts = [group for group in groups if group.signal in ("tau", "current", "effort")]
    # One signal is missing and one is left.
    if "q" in have and not efforts and len(whole) == 1:
        return [replace(only, signal="effort", reason="it is the only remaining signal")]
    if "q" not in have and efforts:
        best = min(efforts, key=lambda group: (group.rank, group.signal != "tau"))
        share = unexplained(only.columns, best.columns)
        if share < EXPLAINED:
            reason = (
                "no other column has the name of a position, and with it the dynamics leave "
                f"{format_percent(share, decimals=0)} of the torque unexplained"
            )
            return [replace(only, signal="q", reason=reason)]
    return []


def _build_group(columns: tuple[int, ...], named: Sequence[ColumnName], reason: str) -> ColumnGroup:
    members = [named[index] for index in columns]
    # Of a robot that turns and slides the units differ; that of the first joint tells the signal.
    unit = members[0].unit
    signal = members[0].signal if len({member.signal for member in members}) == 1 else None
    return ColumnGroup(
        columns, signal or get_signal_of_unit(unit), unit, max(member.rank for member in members), members[0], reason
    )


def _match_joint_name(words: tuple[str, ...], joint_names: Sequence[str]) -> tuple[int, tuple[str, ...]] | None:
    """Return the joint whose name the words hold, the longest where several do, and the words without it."""
    best: tuple[int, int, int] | None = None
    for joint, spellings in enumerate(list_spellings_by_joint(joint_names)):
        for spelling in spellings:
            place = find_phrase(words, spelling)
            # The longest name wins: "wrist_1" must not be taken for a joint "wrist".
            if place is not None and (best is None or len(spelling) > best[1]):
                best = joint, len(spelling), place
    if best is None:
        return None
    joint, length, place = best
    return joint, (*words[:place], "*", *words[place + length :])


def _group_by_number(
    named: Sequence[ColumnName],
    used: set[int],
    joints: Sequence[int | None],
    alive: BoolArray | None,
    clocks: Collection[int],
) -> tuple[_Stems, _Reasons, set[int]]:
    """Group columns whose names differ by one number that counts all joints, from 0, from 1, or all from another.

    `joints` are those of the description: their numbers, None where they are locked. Their columns come last.
    """
    n = len(joints) - joints.count(None)
    stems = _list_counted_columns(named, used, n, clocks)
    # What is counted behind the joints and never has a torque, while its position moves, is a gripper.
    idle = {
        number
        for members in stems.values()
        for number, index in members.items()
        if alive is not None and not alive[index] and named[index].signal in _EFFORTS
    }
    by_stem, reasons, of_locked = _Stems(), _Reasons(), set[int]()
    # A name may hold several numbers, and only one of them counts the joints: the one with as many as these first.
    for stem, members in sorted(stems.items(), key=lambda pair: (len(pair[1]) != n, -len(pair[1]))):
        first, last = min(members), max(members)
        if last - first + 1 != len(members) or len(members) < n or used & set(members.values()):
            continue
        if n < len(joints) == len(members):
            by_stem[stem] = {joint: members[first + k] for k, joint in enumerate(joints) if joint is not None}
            reasons[stem] = f"the joints are counted from {first} in the names, locked ones included"
            used, of_locked = used | set(members.values()), of_locked | set(members.values())
            continue
        behind = [index for number, index in members.items() if number >= first + n]
        # As many as joints, or more of which none behind them ever has a torque: places of joints it does not have.
        moves = behind and (alive is None or alive[behind].any())
        # More than the joints, beside as many other joints that are not counted, are of another device, such as a hand.
        is_other = first > 1 or (moves and not idle >= set(range(first + n, last + 1)))
        if behind and (is_other or _count_other_joints(named) >= n):
            continue
        by_stem[stem] = {number - first: index for number, index in members.items() if number < first + n}
        reasons[stem] = f"the joints are counted from {first} in the names"
        if behind:
            reasons[stem] += f"; the {len(behind)} behind them never {'have a torque' if moves else 'change'}"
        used = used | set(members.values())
    pendant, why = _group_by_pendant_names(named, used, n)
    return by_stem | pendant, reasons | why, of_locked


def _count_other_joints(named: Sequence[ColumnName]) -> int:
    """Return how many joints have a position and an effort by names that do not count them."""
    signals = [column.signal for column in named if not column.numbers]
    return min(signals.count("q"), sum(signal in _EFFORTS for signal in signals))


def _list_counted_columns(named: Sequence[ColumnName], used: set[int], n: int, clocks: Collection[int]) -> _Stems:
    """Return columns that belong to no group, by their names but for one number, and by that; no clocks before them."""
    stems = _Stems()
    for index, column in enumerate(named):
        for place, word in enumerate(column.words if index not in used else ()):
            if word.isdecimal():
                stem = (*column.words[:place], "#", *column.words[place + 1 :])
                stems.setdefault(stem, {}).setdefault(int(word), index)
    for members in stems.values():
        # Files without names begin with counters and times, which are numbered with the joints.
        counters = [number for number, index in members.items() if index in clocks]
        if counters and len(members) == n + len(counters):
            for number in counters:
                del members[number]
    return stems


def _group_by_pendant_names(named: Sequence[ColumnName], used: set[int], n: int) -> tuple[_Stems, _Reasons]:
    groups, reasons = _Stems(), _Reasons()
    for pendant, shown in PENDANTS:
        stems = _Stems()
        for index, column in enumerate(named):
            for joint, words in enumerate(pendant if index not in used and len(pendant) == n else ()):
                if (place := find_phrase(column.words, words)) is not None:
                    stem = (*column.words[:place], "*", *column.words[place + len(words) :])
                    stems.setdefault(stem, {}).setdefault(joint, index)
        whole = {stem: group for stem, group in stems.items() if len(group) == n}
        groups |= whole
        reasons |= dict.fromkeys(whole, f"the joints are named {shown}")
    return groups, reasons
