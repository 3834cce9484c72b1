"""Group columns of robots with few joints: a single joint, or axes called x, y and z."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.identification.imports.groups import ColumnGroup
from dynident.identification.imports.words import ColumnName, Signal
from dynident.robot import Robot

_LETTERS = "xyz"
_SIGNALS = ("q", "dq", "ddq", "tau", "current", "effort", "temperature")
_LENGTHS = ("m", "mm", "cm")
_FORCES = frozenset({"f", "force", "kraft", "forces"})


def group_few_joints(named: Sequence[ColumnName], rest: Sequence[int], robot: Robot) -> list[ColumnGroup]:
    """Group columns that belong to the only joint, or by their letters to axes that all slide.

    Parameters
    ----------
    named : sequence of Named
        What the names of all columns say.
    rest : sequence of int
        The columns that belong to no group yet.
    robot : Robot

    Returns
    -------
    list of Group
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
            first = named[columns[0]]
            groups.append(
                ColumnGroup(columns, signal, first.unit, rank, first, "the axes are called by their letters, in order")
            )
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
