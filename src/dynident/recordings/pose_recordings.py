"""Files of poses at rest: recognise, read and write them; the fewest (4) and most poses (20,000).

Nothing can be filtered or differentiated across them: every row is a segment of its own.
"""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray
from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.file_source import RawRows, RawSource
from dynident.recordings.recording import Recording, Segment, are_readings
from dynident.recordings.recording_metadata import Check
from dynident.recordings.row_storage import ArraySink, ParquetSink
from dynident.recordings.sampling_clock import LONGEST_PERIOD, TimeBase
from dynident.recordings.uniform_segments import GridRows

POSES = "poses"
"""Role of such a recording."""

FEWEST = 4
MOST_ROWS = 20_000
"""A robot that goes to a pose every second for five hours."""

_MOVES = 0.1
"""rad or m: a joint that spans less says nothing of how rows follow one another."""

_ROUGH = 1.0
"""Second differences of a position, rms, over its standard deviation: 2.4 for poses in any order, 1.4 where each pose
has two rows, and 0.6 for a motion of 0.5 Hz that is logged four times a second; slower or quicker, less."""

_SHARE = 0.5
"""Share of the joints that span anything which has to jump: of a grid of poses some joints go in steps."""


def are_poses(q: FloatArray) -> bool:
    """Return whether positions are poses in a list, and no samples of a motion.

    Parameters
    ----------
    q : (m, n)
        Positions in rad or m.

    Returns
    -------
    bool
        True for poses.
    """
    if len(q) < FEWEST:
        return False
    q = _drop_outliers(q)
    moves = np.ptp(q, axis=0) > _MOVES
    if not moves.any():
        return False
    # A motion is smooth: its second differences are small against its spread; those of unrelated poses are not.
    second = np.sqrt((np.diff(q[:, moves], n=2, axis=0) ** 2).mean(axis=0))
    return bool((second > _ROUGH * q[:, moves].std(axis=0)).mean() >= _SHARE) or _are_on_grid(q[:, moves])


def _are_on_grid(q: FloatArray) -> bool:
    """Return whether positions of joints that move are a grid of several joints, which one of them runs through."""
    span = np.ptp(q, axis=0)
    order = np.argsort(q, axis=0)
    gaps, steps = np.diff(np.take_along_axis(q, order, axis=0), axis=0) / span, np.abs(np.diff(q, axis=0)) / span
    if len(span) < 2 or ((gaps > _SAME_PLACE) & (gaps < _NEXT_PLACE)).any():
        return False
    # One joint goes from place to place in nearly every row, and back from the last to the first, while others stay.
    middle = np.median(steps, axis=0)
    runs = middle > _NEXT_PLACE
    if np.count_nonzero(runs) != 1 or (steps.max(axis=0) <= _BACK * middle)[runs].any():
        return False
    # A motion reaches few of all combinations of places, as those of a coarse encoder.
    places = np.zeros(q.shape, dtype=np.int64)
    np.put_along_axis(places, order[1:], np.cumsum(gaps > _SAME_PLACE, axis=0), axis=0)
    return 2 * len(np.unique(places, axis=0)) > float(np.prod(places.max(axis=0) + 1.0))


_SAME_PLACE, _NEXT_PLACE, _BACK = 1e-3, 1e-2, 3.0
"""Shares of a joint's span below which two positions are one place of a grid, and above which they are two; and the
way back to the first place, at least, over the way from one place to the next."""


def _drop_outliers(q: FloatArray) -> FloatArray:
    """Return the positions without the few rows that are far from all others: corrupted samples of a motion."""
    low, high = np.percentile(q, [_FEW, 100.0 - _FEW], axis=0)
    far = ((q < low - _FAR * (high - low)) | (q > high + _FAR * (high - low))).any(axis=1)
    return q[~far] if np.count_nonzero(far) <= 0.01 * _FEW * len(q) else q


_FEW, _FAR = 2.0, 1.0
"""Per cent of the rows at either end that may be corrupted, and how many spans of the others these lie outside them."""


def has_poses(recording: Recording) -> bool:
    """Return whether each row of a recording is a pose."""
    return recording.role == POSES


def read_poses(source: RawSource, layout: Layout, base: TimeBase) -> RawRows | None:
    """Read a file whose rows are poses; None if they are samples of a motion."""
    # Rows that are close together are samples of a motion, however slow it is.
    if base.typical <= LONGEST_PERIOD or not FEWEST <= base.n_rows <= MOST_ROWS:
        return None
    # There are few rows, as was just made sure of: all are held at once.
    blocks = list(source.rows(layout))
    t, segment, values = (
        np.concatenate([getattr(block, name) for block in blocks]) for name in ("t", "segment", "values")
    )
    # A pose needs a position and a torque of every joint. Rows that lack one are left out, and counted in the check.
    is_complete = np.all(are_readings(values[:, layout.needed_columns]), axis=1)
    rows = RawRows(0, t[is_complete], segment[is_complete], values[is_complete])
    return rows if are_poses(rows.values[:, layout.columns_of_kind("q")]) else None


def write_poses(rows: RawRows, sink: ParquetSink | ArraySink) -> tuple[Segment, ...]:
    """Store the rows, each a segment of its own."""
    segments = []
    for k, (t, label) in enumerate(zip(rows.t, rows.segment, strict=True)):
        sink.write(GridRows(rows.t[k : k + 1], int(label), rows.values[k : k + 1]))
        segments.append(Segment(k, 1, float(t), int(label)))
    return tuple(segments)


def read_pose_rows(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return times (m,), positions and torques (m, n) of the poses inside the windows."""
    blocks = list(recording.source.rows(0, recording.n_samples, recording.n_samples))
    q, tau = (np.concatenate([getattr(block, name) for block in blocks]) for name in ("q", "tau"))
    # Every row is a segment of its own: the segments' times are those of the rows.
    t = np.array([segment.start_time for segment in recording.segments])
    used = recording.inside_windows(t)
    return t[used], q[used], tau[used]


def report_poses(rows: RawRows, base: TimeBase) -> tuple[Check, ...]:
    """Report that the rows are poses, and how many rows held no numbers."""
    lost = base.n_rows - len(rows.t)
    remark = f" {lost} rows contain no valid numbers and are left out." if lost else ""
    return (
        Check(
            "poses",
            "warning" if lost else "ok",
            f"{len(rows.t)} poses at rest, one per row, {base.typical:.3g} s apart: they identify gravity and "
            f"constant torques only, not the dynamics.{remark}",
        ),
    )
