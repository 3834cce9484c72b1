"""Apply revisions and cures to a file's metadata (windows, order, sign, unit); the file stays as it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import get_args

from dynident.recordings.recording_metadata import Axis, Check, RecordingError, RecordingMetadata, Revision, Windows
from dynident.recordings.units import format_time


def adapt_cures(checks: Sequence[Check], metadata: RecordingMetadata, joint_names: Sequence[str]) -> tuple[Check, ...]:
    """Return checks whose proposed revisions take the present metadata into account.

    A check sees the recording as it was read, and knows neither the order nor the signs nor the delay that were stated.

    Parameters
    ----------
    checks : sequence of Check
        Checks of the recording as it was read.
    metadata : RecordingMetadata
        What the user says of the file.
    joint_names : sequence of str
        Names of the n joints, in the robot's order.

    Returns
    -------
    tuple of Check
        The same checks, with revisions of the file.
    """
    return tuple(
        check if check.apply is None else replace(check, apply=adapt_revision(check.apply, metadata, joint_names))
        for check in checks
    )


def adapt_revision(revision: Revision, metadata: RecordingMetadata, joint_names: Sequence[str]) -> Revision:
    """Return a revision of the recording as it was read as a revision of its file.

    Parameters
    ----------
    revision : Revision
        Found on the recording, to which the metadata were applied already.
    metadata : RecordingMetadata
        What the user says of the file.
    joint_names : sequence of str
        Names of the n joints, in the robot's order.

    Returns
    -------
    Revision
        What is to be said of the file.
    """
    before = ColumnArrangement(metadata, joint_names)
    n = before.n
    permutation = {
        kind: tuple(before.find_source_joint(kind, column - 1) + 1 for column in order)
        for kind, order in revision.permutation.items()
    }
    signs: dict[str, float] = {}
    scale: dict[str, float] = {}
    for kind in get_args(Axis):
        # Signs and factors are stated of joints, and belong to columns: a new order takes them along.
        order = revision.permutation.get(kind, tuple(range(1, n + 1)))
        for stated, new, changed in ((before.sign, revision.signs, signs), (before.scale, revision.scale, scale)):
            for joint, column in enumerate(order):
                # A sign goes with its column to the joint that reads it from now on.
                value = new.get(f"{kind}{joint + 1}", 1.0) * stated(kind, column - 1)
                if value != stated(kind, joint):
                    changed[f"{kind}{joint + 1}"] = value
    zeros = _adapt_zeros(revision, before)
    # What was found comes on top of what was corrected while reading.
    delay = None if revision.torque_delay is None else metadata.torque_delay + revision.torque_delay
    exclude = None if revision.exclude is None else (*metadata.exclude, *revision.exclude)
    return replace(
        revision,
        permutation=permutation,
        signs=signs,
        scale=scale,
        zeros=zeros,
        torque_delay=delay,
        exclude=exclude,
    )


def _adapt_zeros(revision: Revision, before: ColumnArrangement) -> dict[str, float]:
    """Return zeros that go with their columns to other joints, and follow their signs and factors."""
    zeros: dict[str, float] = {}
    for joint, column in enumerate(revision.permutation.get("q", range(1, before.n + 1))):
        key = f"q{joint + 1}"
        factor = revision.signs.get(key, 1.0) * revision.scale.get(key, 1.0)
        value = factor * before.zero("q", column - 1) + revision.zeros.get(key, 0.0)
        if value != before.zero("q", joint):
            zeros[key] = value
    return zeros


def exclude_from_windows(windows: Windows, exclude: Windows, first: float, last: float) -> Windows:
    """Return the windows to use when some seconds of t are excluded.

    Parameters
    ----------
    windows : pairs (from, to)
        Seconds of t to use; empty: all of the recording.
    exclude : pairs (from, to)
        Seconds of t to leave out.
    first, last : float
        Times of the recording's ends in s.

    Returns
    -------
    pairs (from, to)
        Seconds of t that are left.

    Raises
    ------
    RecordingError
        If nothing is left.
    """
    remaining = [(float(start), float(end)) for start, end in (windows or ((first, last),))]
    if not exclude:
        return windows
    for start, end in exclude:
        # Of every window, what lies before the excluded interval and what lies behind it; either may be empty.
        parts = [((a, min(b, start)), (max(a, end), b)) for a, b in remaining]
        remaining = [part for pair in parts for part in pair if part[1] > part[0]]
    if not remaining:
        raise RecordingError(
            f"exclude removes the whole recording, which runs from {format_time(first)} to {format_time(last)} s.",
            pointer="/exclude",
            title="Empty window",
        )
    return tuple(remaining)


class ColumnArrangement:
    """Which joint's columns each joint reads, and the factor that they are multiplied by."""

    def __init__(self, metadata: RecordingMetadata, joint_names: Sequence[str], n_base: int = 0) -> None:
        # The coordinates of a base that moves stay in their place; numbers count the joints behind them.
        self._names, self._n_base = tuple(joint_names), n_base
        self._metadata = metadata
        self._check()

    def find_source_joint(self, kind: str, joint: int) -> int:
        """Return the joint, from 0, whose column is read for a signal of a joint."""
        group = _GROUPS.get(kind)
        order = None if group is None else self._metadata.permutation.get(group)
        if order is None or joint < self._n_base:
            return joint
        return order[joint - self._n_base] - 1 + self._n_base

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self._names)

    def factor(self, kind: str, joint: int) -> float:
        """Return what the column that is read is multiplied by, besides its unit."""
        group = _GROUPS.get(kind)
        return 1.0 if group is None else self.sign(group, joint) * self.scale(group, joint)

    def sign(self, group: str, joint: int) -> float:
        """Return 1 or -1 for a joint's position ("q") or torque ("tau")."""
        return self._find_value(self._metadata.signs, group, joint)

    def scale(self, group: str, joint: int) -> float:
        """Return the factor of a joint's position or torque."""
        return self._find_value(self._metadata.scale, group, joint)

    def zero(self, kind: str, joint: int) -> float:
        """Return a joint's position, after sign and factor, where the description has 0; 0 for other signals."""
        return self._find_value(self._metadata.zeros, "q", joint, 0.0) if kind in ("q", "q_command") else 0.0

    def _find_value(self, values: Mapping[str, float], group: str, joint: int, usual: float = 1.0) -> float:
        keys = [f"{group}{joint + 1 - self._n_base}", f"{group}_{self._names[joint]}", group]
        if joint < self._n_base:
            # What is said of all joints is not said of the base.
            keys = [f"{group}_{self._names[joint]}"]
        return float(next((values[key] for key in keys if key in values), usual))

    def _check(self) -> None:
        n, metadata = len(self._names) - self._n_base, self._metadata
        for kind, order in metadata.permutation.items():
            if kind not in ("q", "tau") or sorted(order) != list(range(1, n + 1)):
                raise RecordingError(
                    f"permutation gives {kind!r} the order {list(order)}; give q or tau the numbers 1 to {n}, each "
                    "once: entry k is the number of the column of joint k.",
                    pointer=f"/permutation/{kind}",
                    title="Unusable order",
                )
        endings = ["", *(str(joint + 1) for joint in range(n)), *(f"_{name}" for name in self._names)]
        for field_name, values, kinds in (
            ("signs", metadata.signs, ("q", "tau")),
            ("scale", metadata.scale, ("q", "tau")),
            ("zeros", metadata.zeros, ("q",)),
        ):
            known_keys = {f"{kind}{ending}" for kind in kinds for ending in endings}
            for key, value in values.items():
                if key not in known_keys:
                    raise RecordingError(
                        f"{field_name} names {key!r}; name {', '.join(kinds)}, or the signal of one joint: "
                        f"{kinds[-1]}2, {kinds[-1]}_{self._names[0]}.",
                        pointer=f"/{field_name}/{key}",
                        title="Unknown column",
                    )
                if field_name == "signs" and abs(value) != 1.0:
                    raise RecordingError(f"signs of {key} is {value}; give 1 or -1.", pointer=f"/signs/{key}")


_GROUPS: dict[str, Axis] = {"q": "q", "q_command": "q", "dq": "q", "ddq": "q", "tau": "tau", "current": "tau"}
"""Signals that change place and sign together."""
