"""Find joints of the robot that a file lacks, or lacks a signal of; and columns of joints that the robot lacks."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

import numpy as np

from dynident.arrays import FloatArray
from dynident.identification.imports.groups import ColumnGroup, find_incomplete_groups
from dynident.identification.imports.proposal import Question
from dynident.identification.imports.words import ColumnName, Signal
from dynident.recordings.checks_of_motion import MOVED
from dynident.robot import Robot

_POSITIONS: tuple[Signal, ...] = ("q",)
_EFFORTS: tuple[Signal, ...] = ("tau", "current", "effort")
_OF_JOINTS: tuple[Signal, ...] = ("q", "dq", *_EFFORTS)
_AT_ZERO, _MOST = 1e-3, 2.0 * np.pi
"""rad or m: a locked joint's position below the first is 0; one above the second is no angle in radians."""


def find_columns_of_other_joints(named: Sequence[ColumnName], columns: Mapping[str, str], n: int) -> list[str]:
    """Return the columns of joints that a robot of n joints lacks, where all of its own joints have theirs."""
    if f"q{n}" not in columns or not {"tau1", "current1"} & set(columns):
        return []
    used = set(columns.values())
    known = {word for column in named if column.name in used for word in column.words}
    strange = [
        column for column in named if column.signal in _OF_JOINTS and column.rank < 4 and column.name not in used
    ]
    return [column.name for column in strange if not set(column.words) <= known]


def ask_for_missing_joints(named: Sequence[ColumnName], robot: Robot) -> Question | None:
    """Ask to lock joints that have no column at all; None where the positions are not those of most joints."""
    positions = _find_columns_of_most_joints(named, robot, _POSITIONS)
    if positions is None:
        return None
    names = [name for joint, name in enumerate(robot.joint_names) if joint not in positions[1]]
    where = f"{', '.join(names)} {'are' if len(names) > 1 else 'is'} in the robot, and not in the file"
    return Question("robot", f"{where}: lock {_get_pronoun(names)}, --lock {','.join(names)}.")


def find_torque_of_most_joints(
    named: Sequence[ColumnName], robot: Robot, positions: FloatArray, empty: int
) -> ColumnGroup | Question | None:
    """Return the torques that most joints have; a question where a joint without torque stands still.

    Parameters
    ----------
    named : sequence of Named
    robot : Robot
    positions : (m, n)
        Of all joints, in any unit.
    empty : int
        The column that is put in the place of missing torques.

    Returns
    -------
    Group, Question or None
        None where there are no such torques.
    """
    torques = _find_columns_of_most_joints(named, robot, _EFFORTS)
    if torques is None:
        return None
    first, columns = torques
    # A joint that stands still and has no torque is probably a gripper or a fixed axis: it is to be locked, not
    # identified.
    still = [k for k in range(robot.n) if k not in columns and np.ptp(positions[:, k]) <= MOVED[robot.joints[k].kind]]
    if still:
        names = [robot.joint_names[joint] for joint in still]
        locks = [_write_lock(name, positions[:, joint]) for name, joint in zip(names, still, strict=True)]
        verbs = "stand still and have" if len(names) > 1 else "stands still and has"
        return Question(
            "robot", f"{', '.join(names)} {verbs} no torque: lock {_get_pronoun(names)}, --lock {','.join(locks)}."
        )
    members = tuple(columns.get(joint, empty) for joint in range(robot.n))
    return ColumnGroup(members, first.signal, first.unit, first.rank, first, "they are of most joints, by their names")


def _find_columns_of_most_joints(
    named: Sequence[ColumnName], robot: Robot, signals: Collection[Signal]
) -> tuple[ColumnName, dict[int, int]] | None:
    """Return the columns, by joint, of the most likely of some signals."""
    groups = [group for group in find_incomplete_groups(named, robot.joint_names) if group[0].signal in signals]
    measured = [group for group in groups if group[0].rank < 4]
    return min(measured, key=lambda group: (group[0].rank, group[0].signal != "tau"), default=None)


def _get_pronoun(names: Sequence[str]) -> str:
    return "them" if len(names) > 1 else "it"


def _write_lock(name: str, position: FloatArray) -> str:
    at = float(np.median(position))
    return f"{name}={at:.4g}" if _AT_ZERO < abs(at) < _MOST else name
