"""Columns of robots with so few joints that no number tells them apart: a single joint, or axes called x, y and z."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification.imports.groups import Group
from dynident.identification.imports.words import Named, Signal
from dynident.robot import Robot

_LETTERS = "xyz"
_SIGNALS = ("q", "dq", "ddq", "tau", "current", "effort", "temperature")
_LENGTHS = ("m", "mm", "cm")
_FORCES = frozenset({"f", "force", "kraft", "forces"})


def groups_of_few_joints(named: Sequence[Named], rest: Sequence[int], robot: Robot) -> list[Group]:
    """Put columns into groups that belong to the only joint, or by their letters to axes that all slide.

    Parameters
    ----------
    named : what all columns are called
    rest : numbers
        The columns that belong to no group yet.
    robot : Robot

    Returns
    -------
    list of Group
    """
    slides = all(joint.kind == "prismatic" for joint in robot.joints)
    told = {index: _signal(named[index], slides=slides) for index in rest}
    if robot.n == 1:
        return [
            Group((index,), signal, named[index].unit, named[index].rank, named[index], "the robot has one joint")
            for index, signal in told.items()
            if signal is not None
        ]
    if not slides or robot.n > len(_LETTERS):
        return []
    found: dict[tuple[Signal, int], dict[str, int]] = {}
    for index, signal in told.items():
        letter = _letter(named[index])
        if signal is not None and letter:
            found.setdefault((signal, named[index].rank), {}).setdefault(letter, index)
    groups = []
    for (signal, rank), places in found.items():
        if len(places) == robot.n:
            columns = tuple(places[letter] for letter in sorted(places))
            one = named[columns[0]]
            groups.append(Group(columns, signal, one.unit, rank, one, "the axes are called by their letters, in order"))
    return groups


def _letter(one: Named) -> str:
    """The axis that a name is of: the only one of its words that is x, y or z, or ends a force's, fx."""
    found = [word[-1] for word in one.words if word in _LETTERS or word[:-1] in _FORCES]
    return found[0] if len(found) == 1 and found[0] in _LETTERS else ""


def _signal(one: Named, *, slides: bool) -> Signal | None:
    if one.signal in _SIGNALS:
        return one.signal
    if not slides or one.signal not in (None, "other"):
        return None
    if any(word in _FORCES or (word[:-1] in _FORCES and word[-1] in _LETTERS) for word in one.words):
        return "tau"
    if one.unit == "N":
        return "tau"
    is_length = one.unit in _LENGTHS or (one.unit is None and one.words in tuple((letter,) for letter in _LETTERS))
    return "q" if is_length and one.signal is None else None
