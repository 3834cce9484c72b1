"""Filtered rows of a recording that mistakes are looked for in: as an identification filters them, or narrower."""

from __future__ import annotations

from dataclasses import replace
from math import floor

import numpy as np

from dynident.arrays import FloatArray, IntArray
from dynident.errors import DynidentError
from dynident.identification.mistakes.judge import BLOCKS
from dynident.identification.mistakes.swaps import Motion
from dynident.recordings import Recording, choose_preprocessing
from dynident.recordings.choosing import LEAST_HARMONICS, OVERSAMPLING, motion_band
from dynident.recordings.evidence import shortened
from dynident.recordings.types import SampleBlock
from dynident.regressors.stream import parallel_filtered

_ROWS = 2500


def motion_of(recording: Recording) -> Motion | None:
    """Filtered rows from all over a recording; None where it is too short to be filtered."""
    found = whole_motion_of(recording)
    return None if found is None else thinned(found[0])


def thinned(motion: Motion) -> Motion:
    """As many rows from all over a motion as mistakes are looked for in."""
    step = max(1, len(motion.q) // _ROWS)
    q, dq, ddq, tau = (np.ascontiguousarray(one[::step]) for one in (motion.q, motion.dq, motion.ddq, motion.tau))
    block: IntArray = np.arange(len(q)) * BLOCKS // len(q)
    return Motion(q, dq, ddq, tau, block)


def whole_motion_of(recording: Recording, *, narrow: bool = False) -> tuple[Motion, float] | None:
    """Filtered rows in their order, and the seconds between them; None where it is too short to be filtered.

    `narrow` keeps a few harmonics of the motion alone. What a mistake in the columns does to the torque is there, while
    an elastic arm, or one that rattles, has most of what no rigid robot explains above that.
    """
    try:
        choice = choose_preprocessing([recording])
        cutoff = choice.torque_cutoff
        if narrow and cutoff is not None:
            cutoff = min(cutoff, LEAST_HARMONICS * motion_band([recording]))
            choice = replace(choice, decimation=max(1, floor(recording.sampling_rate / (OVERSAMPLING * cutoff))))
    except DynidentError:
        return None
    # Both filtered alike: positions go through both filters here, and fits of them are only held against each other.
    choice = replace(choice, position_cutoff=cutoff, torque_cutoff=cutoff)
    n = recording.n

    def values(block: SampleBlock) -> FloatArray:
        return np.concatenate([block.q, block.dq, block.ddq, block.tau], axis=1)

    short = shortened(recording, choice.decimation)
    rows = [part for _, _, part in parallel_filtered(short, choice, values)]
    whole = np.concatenate(rows) if rows else np.zeros((0, 4 * n))
    if not len(whole):
        return None
    block: IntArray = np.arange(len(whole)) * BLOCKS // len(whole)
    q, dq, ddq, tau = (np.ascontiguousarray(part) for part in np.split(whole, 4, axis=1))
    return Motion(q, dq, ddq, tau, block), short.period * choice.decimation
