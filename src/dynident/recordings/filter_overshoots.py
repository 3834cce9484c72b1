"""Find the rows in which only the filter of a joint's positions makes it go the other way."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain
from math import ceil
from weakref import WeakKeyDictionary

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.recordings.joint_phases import FASTER, SLOW, Phases, compute_smear_width, find_phases
from dynident.recordings.pose_recordings import has_poses
from dynident.recordings.position_filter import filtered_blocks
from dynident.recordings.preprocessing import Preprocessing
from dynident.recordings.recording import Recording

_GIBBS = 0.09
"""Share of a step that a filter overshoots by: Gibbs's limit, which a Butterworth filter of high order comes near."""

# Computed once for each recording and filter, and kept as long as the recording lives.
_known: WeakKeyDictionary[Recording, dict[tuple[float, int, float], Phases]] = WeakKeyDictionary()


def find_filtered_phases(recording: Recording, preprocessing: Preprocessing) -> Phases:
    """Return the phases of a recording with the reversals that the filter of its positions makes, computed once.

    The filter overshoots where a joint brakes from full speed to a creep: for some rows the filtered joint moves the
    other way, and friction has the wrong sign. Where the filtered speed changes its sign so, and no halt is near, the
    joint counts as reversing, from the first change to the last.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    preprocessing : Preprocessing
        The filters.
    """
    if preprocessing.position_cutoff is None or has_poses(recording):
        return find_phases(recording)
    width = compute_smear_width(preprocessing, recording.sampling_rate)
    filters = preprocessing.position_cutoff, preprocessing.filter_order, width
    of_filters = _known.setdefault(recording, {})
    if filters not in of_filters:
        recorded = find_phases(recording)
        segments = zip(recorded.halts, _find_overshoots(recording, preprocessing, width), strict=True)
        joined = (tuple(own.with_reversals(t, width) for own, t in zip(*both, strict=True)) for both in segments)
        of_filters[filters] = replace(recorded, halts=tuple(joined))
    return of_filters[filters]


def _find_overshoots(recording: Recording, preprocessing: Preprocessing, width: float) -> list[list[FloatArray]]:
    """Return the times, by segment and joint, at which the filtered speed changes its sign by an overshoot."""
    times: list[list[list[FloatArray]]] = [[[] for _ in range(recording.n)] for _ in recording.segments]
    reach = ceil(2.0 * width / recording.period)
    t, speed = np.zeros(0), np.zeros((0, recording.n))
    segment = judged = 0
    for block in chain(filtered_blocks(recording, preprocessing), (None,)):
        is_end = block is None or block.starts_segment
        # Rows near the end of a block are judged with the next one, which has those behind them.
        last = len(t) if is_end else max(judged, len(t) - reach)
        for j, marks in enumerate(_mark_overshoots(speed, reach)[judged:last].T):
            times[segment][j].append(t[judged:last][marks])
        if block is None:
            break
        first = len(t) if is_end else max(0, last - reach - 1)
        judged, segment = last - first, block.segment
        t, speed = np.concatenate([t[first:], block.t]), np.concatenate([speed[first:], block.dq])
    return [[np.concatenate([np.zeros(0), *of_joint]) for of_joint in by_joint] for by_joint in times]


def _mark_overshoots(speed: FloatArray, reach: int) -> BoolArray:
    """Mark the rows (m, n) behind which a speed changes its sign by what a filter overshoots.

    Speeds up to `reach` rows away are then of one sign but for that. Noise, coarse encoders and ripples make speeds of
    both signs.
    """
    marks = np.zeros(speed.shape, dtype=bool)
    if len(speed) < 2:
        return marks
    low, high = find_largest_near(-speed, reach), find_largest_near(speed, reach)
    is_one_sided = np.minimum(low, high) <= _GIBBS * np.maximum(low, high)
    is_fast = np.maximum(low, high) > FASTER * SLOW
    marks[:-1] = (speed[1:] * speed[:-1] < 0.0) & (is_one_sided & is_fast)[:-1]
    return marks


def find_largest_near(values: FloatArray, reach: int) -> FloatArray:
    """Return the largest value up to some rows away from each; SciPy's filter would take longer to import.

    Parameters
    ----------
    values : (m, n)
        The values.
    reach : int
        Rows on either side.

    Returns
    -------
    (m, n)
    """
    largest, span = np.pad(values, ((reach, reach), (0, 0)), mode="edge"), 1
    while 2 * span <= 2 * reach + 1:
        largest, span = np.maximum(largest[:-span], largest[span:]), 2 * span
    # Two spans, which may overlap, cover the rows on either side.
    rest = 2 * reach + 1 - span
    return np.maximum(largest[: len(values)], largest[rest : rest + len(values)])
