"""The plans of the sets of test motions (§12.3.4.2): which joints move in each run, which are locked, and how."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.errors import DynidentError
from dynident.excitation.design_request import SET_KINDS

SETS = SET_KINDS.names

_WRIST = 3
_POSTURES_OF_A_GROUP = 3
"""Number of runs of a group of joints, each with the others locked elsewhere, which shows the links from new sides."""


@dataclass(frozen=True)
class FreeMotion:
    """The moving joints follow a trajectory of the requested family."""


@dataclass(frozen=True)
class BetweenTwoPoints:
    """The moving joints go back and forth between two points.

    Parameters
    ----------
    short : tuple of int
        Joints that only speed up and slow down again.
    long : tuple of int
        Joints that cruise at full speed. The other moving joints go a little way meanwhile, so that their friction
        has a sign.
    """

    short: tuple[int, ...] = ()
    long: tuple[int, ...] = ()


@dataclass(frozen=True)
class SlowMotion:
    """The moving joints go slowly through many postures."""


@dataclass(frozen=True)
class PlannedRun:
    """One test motion of a set, before its motion is known.

    Parameters
    ----------
    label : str
        Purpose of the run, in words.
    moving : tuple of int
        Indices of the joints that move.
    how : FreeMotion or BetweenTwoPoints or SlowMotion
        How they move.
    """

    label: str
    moving: tuple[int, ...]
    how: FreeMotion | BetweenTwoPoints | SlowMotion


def plan_runs(name: str, joint_names: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return the runs of a set, in the order in which they are made.

    Parameters
    ----------
    name : str
        Name of the set, one of `SETS`.
    joint_names : tuple of str
        Names of the joints from the base to the terminal link.

    Returns
    -------
    tuple of PlannedRun
        The runs.

    Raises
    ------
    DynidentError
        The robot has too few joints for the set.
    """
    if name == "link_by_link":
        return _plan_link_by_link(joint_names)
    if name == "wrist_then_shoulder":
        return _plan_wrist_then_shoulder(joint_names)
    return _plan_vandanjon(joint_names)


def _plan_link_by_link(joints: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return runs from the terminal link inwards [12.22]-[12.24], each of its joint and the two before it.

    These two carry the link about other axes. The joints beyond are locked: their links are known by then, and move as
    one with this link.
    """
    return tuple(
        PlannedRun(f"link {j + 1} ({joints[j]})", tuple(range(max(0, j - 2), j + 1)), FreeMotion())
        for j in reversed(range(len(joints)))
    )


def _plan_wrist_then_shoulder(joints: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return runs of the last three joints with the arm locked, then of the arm with the wrist locked (§12.7)."""
    n = len(joints)
    if n <= _WRIST:
        raise DynidentError(
            f"the robot has {n} joints; a wrist of {_WRIST} and a shoulder need at least {_WRIST + 1}",
            pointer="/trajectory/sets",
        )
    groups = (("wrist", tuple(range(n - _WRIST, n))), ("shoulder", tuple(range(n - _WRIST))))
    return tuple(
        PlannedRun(f"{name}, posture {k + 1}", moving, FreeMotion())
        for name, moving in groups
        for k in range(_POSTURES_OF_A_GROUP)
    )


def _plan_vandanjon(joints: tuple[str, ...]) -> tuple[PlannedRun, ...]:
    """Return runs for four phenomena, one after the other [Vandanjon 95]; together they make one global system."""
    n = len(joints)
    inertia = [PlannedRun(f"inertia, {joints[j]}", (j,), BetweenTwoPoints(short=(j,))) for j in range(n)]
    pairs = [(i, j) for j in range(1, n) for i in (j - 1, j - 2) if i >= 0]
    centrifugal = [
        PlannedRun(f"centrifugal coupling, {joints[i]} on {joints[j]}", (i, j), BetweenTwoPoints(long=(i,)))
        for i, j in pairs
    ]
    coupling = [
        PlannedRun(f"inertial coupling, {joints[i]} and {joints[j]}", (i, j), BetweenTwoPoints(short=(i, j)))
        for i, j in pairs
    ]
    return (*inertia, *centrifugal, *coupling, PlannedRun("gravity", tuple(range(n)), SlowMotion()))
