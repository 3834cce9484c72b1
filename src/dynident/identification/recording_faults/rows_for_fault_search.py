"""Filtered rows of a recording for the search of faults: filtered as for an identification, or narrower."""

from __future__ import annotations

from dataclasses import replace
from math import floor

import numpy as np

from dynident.array_types import FloatArray, IntArray
from dynident.errors import DynidentError
from dynident.identification.recording_faults.column_faults import Motion
from dynident.identification.recording_faults.tree_fit import BLOCKS
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.nonparametric_fit import shorten_recording
from dynident.recordings.preprocessing import LEAST_HARMONICS, OVERSAMPLING, find_motion_band
from dynident.recordings.recording import SampleBlock
from dynident.regressors.filtered_rows import filter_in_parallel

_ROWS = 2500
"""Rows that faults are looked for in: every candidate is fitted to them, so more would take longer and tell little."""


def filter_motion(recording: Recording) -> Motion | None:
    """Return filtered rows from all over a recording; None where it is too short to be filtered.

    Parameters
    ----------
    recording : Recording
        The recording.
    """
    whole = filter_whole_motion(recording)
    return None if whole is None else thin_out(whole[0])


def thin_out(motion: Motion) -> Motion:
    """Return every so many rows of a motion, as many as faults are looked for in.

    Parameters
    ----------
    motion : Motion
        Filtered rows of the recording.
    """
    # Evenly spread, so that every part of the motion is represented.
    step = max(1, len(motion.q) // _ROWS)
    q, dq, ddq, tau = (np.ascontiguousarray(signal[::step]) for signal in (motion.q, motion.dq, motion.ddq, motion.tau))
    block: IntArray = np.arange(len(q)) * BLOCKS // len(q)
    return Motion(q, dq, ddq, tau, block)


def filter_whole_motion(recording: Recording, *, narrow: bool = False) -> tuple[Motion, float] | None:
    """Return the filtered rows in their order, and the seconds between them; None where the recording is too short.

    Parameters
    ----------
    recording : Recording
        The recording.
    narrow : bool
        Keep a few harmonics of the motion alone. A fault of the columns shows there, while an elastic arm, or one with
        backlash, has most of what no rigid robot explains above that.
    """
    try:
        choice = choose_preprocessing([recording])
        cutoff = choice.torque_cutoff
        if narrow and cutoff is not None:
            cutoff = min(cutoff, LEAST_HARMONICS * find_motion_band([recording]))
            choice = replace(choice, decimation=max(1, floor(recording.sampling_rate / (OVERSAMPLING * cutoff))))
    except DynidentError:
        return None
    # Positions and torques go through the same filters, so that neither lags. The fits are only compared with each
    # other, so the filters need not be those of an identification.
    choice = replace(choice, position_cutoff=cutoff, torque_cutoff=cutoff)
    n = recording.n

    def values(block: SampleBlock) -> FloatArray:
        return np.concatenate([block.q, block.dq, block.ddq, block.tau], axis=1)

    # A few minutes tell enough; filtering an hour only takes time.
    short = shorten_recording(recording, choice.decimation)
    rows = [part for _, _, part in filter_in_parallel(short, choice, values)]
    whole = np.concatenate(rows) if rows else np.zeros((0, 4 * n))
    if not len(whole):
        return None
    # Blocks of consecutive rows: held out one by one, they test a fit on motion that it has not seen.
    block: IntArray = np.arange(len(whole)) * BLOCKS // len(whole)
    q, dq, ddq, tau = (np.ascontiguousarray(part) for part in np.split(whole, 4, axis=1))
    return Motion(q, dq, ddq, tau, block), short.period * choice.decimation
