"""Signals of a file as they were logged, for plots; hashes of samples, which tell whether recordings share data.

Nothing is filtered or repaired; the HTTP path `/v1/measurements/{id}/raw` shows all rows, or extremes of fewer rows.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.base_motion import add_base_pose
from dynident.recordings.columns_to_signals import Column, Layout, compute_servo_error, find_columns
from dynident.recordings.file_source import FileSource
from dynident.recordings.formats import open_source
from dynident.recordings.recording import RecordedJoints, Recording
from dynident.recordings.recording_metadata import RecordingError, RecordingMetadata
from dynident.recordings.signal_spectra import find_used_runs
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


Hashes = NDArray[np.uint64]

SHARED = 0.01
"""Share of the moving samples of held-out data that may be of the fit, too: windows that touch share their ends. With
more of them the held-out error is not that of data that no parameter saw."""

_ROWS_TOGETHER = 16
"""Rows that have to be equal one after the other: counts of a coarse encoder and current repeat singly by chance."""
_MOVING = 0.7
"""Share of these rows in which a joint has to move: of one that creeps, coarse counts repeat for many rows."""
_BLOCK = 65_536


@dataclass(frozen=True, eq=False)
class SampleHashes:
    """A hash of position and torque of every row inside the windows, and whether a joint moved since the row before.

    One entry of each list for every run of rows without a gap.
    """

    rows: tuple[Hashes, ...]
    moving: tuple[BoolArray, ...]

    @classmethod
    def from_recording(cls, recording: Recording) -> SampleHashes:
        """Read a recording once, in blocks, and hash its rows."""
        rows, moving = [], []
        for first, length in find_used_runs(recording):
            blocks, last, moved = [], None, []
            for block in recording.source.rows(first, length, _BLOCK):
                blocks.append(_hash_rows(np.hstack([block.q, block.tau])))
                # The first row of a run has none before it and counts as still.
                before = np.vstack([block.q[:1] if last is None else last, block.q[:-1]])
                moved.append((block.q != before).any(axis=1))
                last = block.q[-1:]
            rows.append(np.concatenate(blocks))
            moving.append(np.concatenate(moved))
        return cls(tuple(rows), tuple(moving))

    @property
    def digest(self) -> str:
        """SHA-256, in hexadecimal digits, by which these samples are known whatever their file is called."""
        digest = hashlib.sha256()
        for rows in self.rows:
            # With the lengths: the same rows, split into other runs, are other samples.
            digest.update(len(rows).to_bytes(8, "little"))
            digest.update(rows.tobytes())
        return digest.hexdigest()

    def measure_share_in(self, other: SampleHashes) -> float:
        """Return the share of the rows in motion that are in another recording, too; 0 if nothing moves."""
        # A recording that has shorter runs only is compared by the longest of them.
        together = min(_ROWS_TOGETHER, max((len(hashes) for hashes in self.rows), default=0))
        if not together:
            return 0.0
        other_hashes = np.unique(
            np.concatenate([_hash_runs(hashes, together) for hashes in other.rows] or [np.zeros(0, np.uint64)])
        )
        shared = telling = 0
        for rows, moved in zip(self.rows, self.moving, strict=True):
            # Only rows in motion count: a robot that stands gives equal rows in any two recordings.
            starts = _sum_runs(moved.astype(np.float64), together) >= _MOVING * together
            equal = starts & np.isin(_hash_runs(rows, together), other_hashes)
            telling += _count_covered(starts, together)
            shared += _count_covered(equal, together)
        return shared / telling if telling else 0.0


def find_copied_recordings(fitted: Sequence[SampleHashes], held_out: Sequence[Recording]) -> tuple[str, ...]:
    """Return the names of held-out recordings that hold samples of those that were fitted to.

    Parameters
    ----------
    fitted : sequence of SampleHashes
        Hashes of the recordings that parameters were fitted to.
    held_out : sequence of Recording
        Recordings that no parameter should have seen.

    Returns
    -------
    tuple of str
    """
    own = ((recording.name, SampleHashes.from_recording(recording)) for recording in held_out)
    return tuple(name for name, samples in own if any(samples.measure_share_in(other) > SHARED for other in fitted))


def _sum_runs(values: FloatArray, together: int) -> FloatArray:
    """Return the sums of every so many consecutive values; none if there are fewer."""
    return np.convolve(values, np.ones(together), "valid") if len(values) >= together else np.zeros(0)


def _count_covered(starts: BoolArray, together: int) -> int:
    """Return how many rows lie in the runs of so many rows that start where it is true."""
    # A row that lies in several runs counts once. The full convolution reaches to the last row of the last run.
    return int((np.convolve(starts, np.ones(together)) > 0.5).sum()) if starts.any() else 0


def _hash_rows(values: FloatArray) -> Hashes:
    """Return one hash (m,) for each row of values (m, c): the bits of each, multiplied and added modulo 2**64."""
    bits = np.ascontiguousarray(values + 0.0).view(np.uint64)  # adding zero makes of -0.0 a 0.0
    # Round numbers have zeros in their lower half: the upper half is mixed into it.
    mixed = bits ^ (bits >> np.uint64(32))
    return np.asarray((mixed * _make_factors(bits.shape[1])).sum(axis=1, dtype=np.uint64))


def _hash_runs(rows: Hashes, together: int) -> Hashes:
    """Return a hash of every so many consecutive rows: (m - together + 1,); none if there are fewer."""
    count = len(rows) - together + 1
    if count < 1:
        return np.zeros(0, dtype=np.uint64)
    hashes = np.zeros(count, dtype=np.uint64)
    for k, factor in enumerate(_make_factors(together)):
        # Each place has a factor of its own, so that the same rows in another order give another sum. Unsigned numbers
        # wrap around, as is meant here.
        hashes += rows[k : k + count] * factor
    return hashes


def _make_factors(count: int) -> Hashes:
    """Return odd numbers, always the same."""
    # An odd number has an inverse modulo 2**64: no bit of a value is lost by the product.
    return np.random.default_rng(0).integers(0, 2**63, count, dtype=np.uint64) * np.uint64(2) + np.uint64(1)
