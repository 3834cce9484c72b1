"""How much signals usually change from sample to sample, and how heavy the tails of their noise are."""

from __future__ import annotations

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IntArray
from dynident.recordings.conditioning.windows import CHUNK_ROWS
from dynident.recordings.conditioning.wraps import fold

NEAR_CHUNKS = 4
"""Chunks on either side of a chunk in which the usual step of a signal is looked for."""

TIMES_USUAL = 4.0
"""Times the usual step of a signal (its upper quartile nearby) that a sample has to be off: 7.6 standard deviations of
normal noise. `benchmarks/corrupted_samples.py` calibrates it, and the tails below."""

TAIL_POWER, TAIL_ERRORS = 3.0, 0.005
"""The heaviest tails of noise: of swings beyond a size there are as few as of Student's t with so many degrees of
freedom. And how many of its swings may be expected beyond the threshold in a window: one in 200 windows has one."""


def usual_steps(steps: FloatArray) -> FloatArray:
    """Give the usual size of the steps (m, c) of signals near each row, as (m, c).

    It is the upper quartile of a chunk, and the median of the steps that are not zero where few are not (counts of an
    encoder): the largest of those of the chunks nearby, since noise grows where a joint begins to move.
    """
    m, c = steps.shape
    n = -(-m // CHUNK_ROWS)
    padded = np.full((n * CHUNK_ROWS, c), np.nan)
    np.abs(steps, out=padded[:m])
    chunks = np.sort(padded.reshape(n, CHUNK_ROWS, c), axis=1)
    known = np.isfinite(chunks).sum(axis=1)
    zeros = (chunks == 0.0).sum(axis=1)
    # Of fewer changes than these one corrupted sample would make its own measure.
    several = known - zeros > 4
    at = np.maximum((3 * known) // 4, np.where(several, (known + zeros) // 2, 0))
    own = np.take_along_axis(chunks, np.minimum(at, np.maximum(known - 1, 0))[:, None, :], axis=1)[:, 0]
    own = np.nan_to_num(own)
    near = own.copy()
    for shift in range(1, NEAR_CHUNKS + 1):
        np.maximum(near[shift:], own[:-shift], out=near[shift:])
        np.maximum(near[:-shift], own[shift:], out=near[:-shift])
    return np.repeat(near, CHUNK_ROWS, axis=0)[:m]


def steps_of(values: FloatArray, t: FloatArray, run: IntArray, smooth: BoolArray, periods: FloatArray) -> FloatArray:
    """Give how far each row of values (m, c) is off the one before, of smooth signals off their slope; NaN at edges.

    `smooth` (c,) tells which signals are, `periods` (c,) are those of wrapping angles.
    """
    first = np.full_like(values, np.nan)
    if len(values) < 3:
        return first
    first[1:] = np.diff(values, axis=0)
    for column in np.flatnonzero(periods):
        first[:, column] = fold(first[:, column], float(periods[column]))
    first[1:][np.diff(run) != 0] = np.nan
    result = first
    if smooth.any():
        result = first.copy()
        spread = np.diff(t)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.where(spread[:-1] > 0.0, spread[1:] / spread[:-1], 0.0)
        slope = first[1:-1][:, smooth] * ratio[:, None]
        second = first[2:][:, smooth] - slope
        result[:2, smooth] = np.nan
        result[2:, smooth] = second
    return result


def times_usual(steps: FloatArray, usual: FloatArray) -> float:
    """Give how many usual steps (m,) a sample has to be off, by how often a signal with these steps (m,) swings so far.

    A swing goes up and down again, or the other way round, as a single corrupted sample does. Of normal noise hardly
    any is larger than two usual steps; from the number of those up to four the tail of the others follows.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])) / usual[:-1]
    middle = (size >= 0.5 * TIMES_USUAL) & (size < TIMES_USUAL) & (steps[:-1] * steps[1:] < 0.0)
    low, high = (0.5 * TIMES_USUAL) ** -TAIL_POWER, TIMES_USUAL**-TAIL_POWER
    beyond_one = np.count_nonzero(middle) / (low - high)
    return max(TIMES_USUAL, float(beyond_one / TAIL_ERRORS) ** (1.0 / TAIL_POWER))
