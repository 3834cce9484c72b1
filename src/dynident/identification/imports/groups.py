"""Columns of one signal, one a joint: told by their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dynident.identification.imports.words import Named, Signal, signal_of_unit

_JOINT = frozenset({"joint", "jnt", "j", "axis", "achse", "a", "link"})
_PENDANT = (("base",), ("shoulder",), ("elbow",), ("wrist", "1"), ("wrist", "2"), ("wrist", "3"))
"""What the pendants of one maker call six joints."""


@dataclass(frozen=True)
class Group:
    """Columns (by index) of one signal in the robot's order of joints, what they are and how that is known."""

    columns: tuple[int, ...]
    signal: Signal | None
    unit: str | None
    rank: int
    named: Named
    reason: str

    def among(self, places: list[int]) -> Group:
        """The same group where its columns are at these places of all."""
        return replace(self, columns=tuple(places[index] for index in self.columns))


def groups_of(
    named: Sequence[Named], joint_names: Sequence[str], followers: Sequence[str] = ()
) -> tuple[list[Group], list[int], list[int]]:
    """Put columns that differ by the joint alone together.

    Returns
    -------
    groups, rest, following : list of Group, columns (by index) that belong to none, and those of `followers`: joints
    that are not driven
    """
    following: list[int] = []
    found: dict[tuple[str, ...], dict[int, int]] = {}
    reasons: dict[tuple[str, ...], str] = {}
    for index, one in enumerate(named):
        hit = _by_joint_name(one.words, (*joint_names, *followers))
        if hit is not None and hit[0] >= len(joint_names):
            following.append(index)
        elif hit is not None:
            joint, stem = hit
            found.setdefault(stem, {}).setdefault(joint, index)
            reasons[stem] = "the joint's name stands in the column's"
    taken = {index for group in found.values() if len(group) == len(joint_names) for index in group.values()}
    found = {stem: group for stem, group in found.items() if len(group) == len(joint_names)}
    numbered, why = _by_number(named, taken | set(following), len(joint_names))
    found |= numbered
    reasons |= why
    taken = {index for group in found.values() for index in group.values()} | set(following)
    groups = []
    for stem, group in found.items():
        columns = tuple(group[joint] for joint in range(len(joint_names)))
        groups.append(_group(columns, named, reasons[stem]))
    return groups, [index for index in range(len(named)) if index not in taken], following


def _group(columns: tuple[int, ...], named: Sequence[Named], reason: str) -> Group:
    members = [named[index] for index in columns]
    units = {one.unit for one in members}
    # Of a robot that turns and slides the units differ; that of the first joint tells the signal.
    unit = units.pop() if len(units) == 1 else members[0].unit
    signals = {one.signal for one in members}
    signal = signals.pop() if len(signals) == 1 else None
    return Group(columns, signal or signal_of_unit(unit), unit, max(one.rank for one in members), members[0], reason)


def _by_joint_name(words: tuple[str, ...], joint_names: Sequence[str]) -> tuple[int, tuple[str, ...]] | None:
    """The joint whose name the words hold, the longest where several do, and what is left without it."""
    best: tuple[int, int, int] | None = None
    for joint, name in enumerate(joint_names):
        for wanted in _spellings(name):
            place = _place(words, wanted)
            if place is not None and (best is None or len(wanted) > best[1]):
                best = joint, len(wanted), place
    if best is None:
        return None
    joint, length, place = best
    return joint, (*words[:place], "*", *words[place + length :])


def _spellings(name: str) -> list[tuple[str, ...]]:
    """A joint's name as words, with and without the word joint; none that is a number alone."""
    words = tuple(word.casefold() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name))
    bare = tuple(word for word in words if word != "joint")
    return [one for one in (words, bare) if any(not word.isdigit() and word not in _JOINT for word in one)]


def _place(words: tuple[str, ...], wanted: tuple[str, ...]) -> int | None:
    for start in range(len(words) - len(wanted) + 1):
        if words[start : start + len(wanted)] == wanted:
            return start
    return None


def _by_number(
    named: Sequence[Named], taken: set[int], n: int
) -> tuple[dict[tuple[str, ...], dict[int, int]], dict[tuple[str, ...], str]]:
    """Columns whose names differ by one number that counts all joints, from 0 or from 1."""
    stems: dict[tuple[str, ...], dict[int, int]] = {}
    for index, one in enumerate(named):
        if index in taken:
            continue
        for place, word in enumerate(one.words):
            if word.isdigit():
                stem = (*one.words[:place], "#", *one.words[place + 1 :])
                stems.setdefault(stem, {}).setdefault(int(word), index)
    found: dict[tuple[str, ...], dict[int, int]] = {}
    reasons: dict[tuple[str, ...], str] = {}
    for stem, members in sorted(stems.items(), key=lambda pair: -len(pair[1])):
        for base in (1, 0):
            if set(members) == set(range(base, base + n)) and not taken & set(members.values()):
                found[stem] = {number - base: index for number, index in members.items()}
                reasons[stem] = f"the joints are counted from {base} in the names"
                taken = taken | set(members.values())
                break
    pendant, why = _by_pendant(named, taken, n)
    return found | pendant, reasons | why


def _by_pendant(
    named: Sequence[Named], taken: set[int], n: int
) -> tuple[dict[tuple[str, ...], dict[int, int]], dict[tuple[str, ...], str]]:
    if n != len(_PENDANT):
        return {}, {}
    stems: dict[tuple[str, ...], dict[int, int]] = {}
    for index, one in enumerate(named):
        if index in taken:
            continue
        for joint, words in enumerate(_PENDANT):
            place = _place(one.words, words)
            if place is not None:
                stem = (*one.words[:place], "*", *one.words[place + len(words) :])
                stems.setdefault(stem, {}).setdefault(joint, index)
    whole = {stem: group for stem, group in stems.items() if len(group) == n}
    return whole, dict.fromkeys(whole, "the joints are called base, shoulder, elbow and wrist 1 to 3")
