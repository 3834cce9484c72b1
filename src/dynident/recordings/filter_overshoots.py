"""Find the rows in which only the filter of a joint's positions makes it go the other way."""

from __future__ import annotations

from math import ceil
from weakref import WeakKeyDictionary

import numpy as np

from dynident.array_types import FloatArray
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
    other way, and friction has the wrong sign. Where the filtered speed changes its sign and no halt is near, the joint
    counts as reversing, from the first change to the last.

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
        segments = zip(find_phases(recording).halts, _find_overshoots(recording, preprocessing, width), strict=True)
        joined = (tuple(own.with_reversals(t, width) for own, t in zip(*both, strict=True)) for both in segments)
        of_filters[filters] = Phases(tuple(joined))
    return of_filters[filters]


def _find_overshoots(recording: Recording, preprocessing: Preprocessing, width: float) -> list[list[FloatArray]]:
    """Return the times, by segment and joint, at which the filtered speed changes its sign by an overshoot.

    Speeds within two widths (s) of it are of one sign but for what a filter overshoots by. Noise, coarse encoders and
    ripples make speeds of both signs.
    """
    times: list[list[list[FloatArray]]] = [[[] for _ in range(recording.n)] for _ in recording.segments]
    before = np.zeros(0), np.zeros((0, recording.n))
    for block in filtered_blocks(recording, preprocessing):
        if block.starts_segment:
            before = before[0][:0], before[1][:0]
        t, speed = (np.concatenate(pair) for pair in zip(before, (block.t, block.dq), strict=True))
        reach = ceil(2.0 * width / (recording.period * (preprocessing.decimation or 1)))
        for j, own in enumerate(speed.T):
            for k in np.flatnonzero(own[1:] * own[:-1] < 0.0):
                # Those with too few rows behind them come again with the next block.
                near = own[max(0, k - reach) : k + reach + 2]
                low, high = sorted((-float(near.min()), float(near.max())))
                if low <= _GIBBS * high and high > FASTER * SLOW:
                    times[block.segment][j].append(t[k : k + 1])
        before = t[-2 * reach - 2 :], speed[-2 * reach - 2 :]
    return [[np.unique(np.concatenate([np.zeros(0), *of_joint])) for of_joint in segment] for segment in times]
