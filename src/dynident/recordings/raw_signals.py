"""Signals of a file as they were logged, for plots: all rows, or extremes of fewer rows.

Nothing is filtered or repaired; the HTTP path `/v1/measurements/{id}/raw` shows them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.base_motion import add_base_pose
from dynident.recordings.columns_to_signals import Column, Layout, compute_servo_error, find_columns
from dynident.recordings.file_source import FileSource
from dynident.recordings.formats import open_source
from dynident.recordings.recording import RecordedJoints
from dynident.recordings.recording_metadata import RecordingError, RecordingMetadata
from dynident.recordings.units import STORED_KINDS, find_our_unit


class Rows(NamedTuple):
    """Rows of some signals: t (m,) in s, values (m, c)."""

    t: FloatArray
    values: FloatArray


@dataclass(frozen=True)
class RobotFile:
    """A user's file with its metadata and the joints that its columns are of.

    Parameters
    ----------
    path : path
        Where the file lies.
    metadata : RecordingMetadata
        What the user says of the file.
    joints : RecordedJoints
        The joints and what is known of them.
    """

    path: Path
    metadata: RecordingMetadata
    joints: RecordedJoints


class RecordedSignals:
    """Some signals of a file, in SI units if it is known what they are.

    Parameters
    ----------
    file : RobotFile
        The file, and what is known of it.
    requested : sequence of str
        Names of signals: q1, tau_<joint>, dq, ddq, q_command, temperature likewise, or the file's own columns, which
        are given as they stand there; all positions and torques if none is named. Torques of motors that act on several
        joints are the motors'.

    Raises
    ------
    RecordingError
        For a signal that the file does not hold, and what the layout of the file does not allow.
    """

    def __init__(self, file: RobotFile, requested: Sequence[str] = ()) -> None:
        source = open_source(file.path, file.metadata.format, file.metadata.rate)
        self._source: FileSource = add_base_pose(source, file.joints, file.metadata)
        layout, _ = find_columns(self._source.names, file.joints, file.metadata)
        joint_signals = _find_joint_signals(layout, file)
        names = list(dict.fromkeys(requested)) or [
            f"{kind}{k + 1}" for kind in ("q", "tau") for k in range(len(layout.q))
        ]
        own = {name: (Column(name), "") for name in self._source.names}
        for name in names:
            if name not in joint_signals and name not in own:
                raise RecordingError(
                    f"there is no signal {name!r}; there are: {', '.join(joint_signals)}, and the file's own columns: "
                    f"{', '.join(self._source.names[:40])}",
                    pointer="signals",
                    title="Unknown signal",
                )
        joints = file.joints.names
        self.available = tuple(
            f"{kind}_{name}" for kind in STORED_KINDS for name in joints[: len(getattr(layout, kind))]
        )
        selected = {name: joint_signals.get(name) or own[name] for name in names}
        self._t = layout.t
        # Torques of servos need a second column: that of the position.
        self._servos = {
            name: (layout.q[joint], float(gain))
            for joint, gain in enumerate(() if layout.servo_gains is None else layout.servo_gains)
            for name in (f"tau{joint + 1}", f"tau_{joints[joint]}")
            if name in selected and joint not in layout.without_torque
        }
        self._columns = {name: column for name, (column, _) in selected.items()}
        self.names = tuple(names)
        self.units = {name: unit for name, (_, unit) in selected.items()}

    def rows(self, names: Sequence[str], start: float | None = None, end: float | None = None) -> Iterator[Rows]:
        """Yield the rows of some of the signals from `start` to `end` in s, in blocks."""
        servos = [name for name in names if name in self._servos]
        columns = [*(self._columns[name] for name in names), *(self._servos[name][0] for name in servos)]
        layout = Layout(self._t, None, tuple(columns), ())
        for block in self._source.rows(layout) if names else self._source.times(layout):
            inside = _is_inside(block.t, start, end)
            values = block.values[inside]
            for place, name in enumerate(servos, start=len(names)):
                k = list(names).index(name)
                values[:, k] = self._servos[name][1] * compute_servo_error(values[:, k], values[:, place])
            if inside.any():
                yield Rows(block.t[inside], values[:, : len(names)])

    def count(self, start: float | None = None, end: float | None = None) -> int:
        """Return the number of rows from `start` to `end`."""
        return sum(len(block.t) for block in self.rows((), start, end))

    def thin_rows(self, points: int, start: float | None = None, end: float | None = None) -> tuple[int, Rows]:
        """Return how many rows there are, and about `points` of them, the extremes of every signal among them."""
        total = self.count(start, end)
        # Each part gives two extremes of every signal at most: so wide that all parts give about `points` rows.
        width = max(1, -(-2 * len(self.names) * total // points))
        # Parts of one or two rows would keep every row of a single signal: then all rows are given as they are.
        blocks = self.rows(self.names, start, end)
        parts = list(blocks) if width <= 2 else [_find_extremes(part) for part in _split_rows(blocks, width)]
        if not parts:
            return 0, Rows(np.empty(0), np.empty((0, len(self.names))))
        return total, Rows(
            np.concatenate([extremes.t for extremes in parts]), np.concatenate([extremes.values for extremes in parts])
        )


def _is_inside(t: FloatArray, start: float | None, end: float | None) -> BoolArray:
    inside = np.ones(len(t), dtype=bool)
    if start is not None:
        inside &= t >= start
    if end is not None:
        inside &= t <= end
    return inside


def _split_rows(blocks: Iterator[Rows], width: int) -> Iterator[Rows]:
    """Yield the same rows in parts of `width` rows."""
    waiting: Rows | None = None
    for block in blocks:
        both = block if waiting is None else Rows(*(np.concatenate(pair) for pair in zip(waiting, block, strict=True)))
        whole = len(both.t) // width * width
        for first in range(0, whole, width):
            yield Rows(both.t[first : first + width], both.values[first : first + width])
        # Rows that do not fill a part wait for the next block.
        waiting = Rows(both.t[whole:], both.values[whole:])
    if waiting is not None and len(waiting.t):
        yield waiting


def _find_extremes(part: Rows) -> Rows:
    """Return the rows in which a signal is largest or smallest."""
    # NumPy takes NaN for the extreme: a missing sample counts as the opposite of what is looked for.
    low, high = (np.where(np.isnan(part.values), worst, part.values) for worst in (np.inf, -np.inf))
    at: IntArray = np.unique(np.concatenate([low.argmin(axis=0), high.argmax(axis=0)]))
    return Rows(part.t[at], part.values[at])


def _find_joint_signals(layout: Layout, file: RobotFile) -> dict[str, tuple[Column, str]]:
    """Return the signals of joints by their names, with column and unit."""
    signals: dict[str, tuple[Column, str]] = {}
    for kind in STORED_KINDS:
        for joint, column in enumerate(getattr(layout, kind)):
            unit = find_our_unit(kind, file.joints.known_limits[joint].kind)
            signals[f"{kind}{joint + 1}"] = signals[f"{kind}_{file.joints.names[joint]}"] = (column, unit)
    return signals
