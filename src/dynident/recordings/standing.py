"""Which joints stand still throughout a run."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np

from dynident.recordings.filtering import READ_LENGTH
from dynident.recordings.types import BoolArray, Recording

STANDS = 2e-3
"""Travel in rad or m that noise and a controller's play leave a joint that is not meant to move."""

_known: WeakKeyDictionary[Recording, BoolArray] = WeakKeyDictionary()


def standing_joints(recording: Recording) -> BoolArray:
    """(segments, n): joints that stand still in all of a segment's rows inside the windows."""
    if recording not in _known:
        _known[recording] = np.array([_in_segment(recording, k) for k in range(len(recording.segments))])
    return _known[recording]


def _in_segment(recording: Recording, index: int) -> BoolArray:
    segment = recording.segments[index]
    low, high = np.full(recording.n, np.inf), np.full(recording.n, -np.inf)
    done = 0
    for rows in recording.source.rows(segment.first_row, segment.length, READ_LENGTH):
        numbers = np.arange(done, done + len(rows.q), dtype=np.float64)
        t = segment.start_time + numbers * recording.period
        used = rows.q[recording.inside_windows(t)]
        done += len(rows.q)
        if len(used):
            np.minimum(low, used.min(axis=0), out=low)
            np.maximum(high, used.max(axis=0), out=high)
    return np.asarray(high - low <= STANDS)
