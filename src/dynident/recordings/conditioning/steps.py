"""Usual sizes of the changes of a signal from sample to sample, and how heavy the tails of its noise are."""

from __future__ import annotations

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IntArray
from dynident.recordings.conditioning.windows import CHUNK_ROWS
from dynident.recordings.conditioning.wraps import fold_angles

NEAR_CHUNKS = 4
"""Chunks on either side of a chunk in which the usual step of a signal is looked for."""

TIMES_USUAL = 4.0
"""Times the usual step of a signal (its upper quartile nearby) that a sample has to be off: 7.6 standard deviations of
normal noise. `benchmarks/corrupted_samples.py` calibrates it, and the tails below."""

LIGHT_SHARE, TAIL_GROWTH = 0.002, 900.0
"""Share of rows in which noise swings by two to four usual steps: at most so many of normal noise (0.0009), 0.0035 of
Student's t with 5 degrees of freedom, 0.0075 with 3. And how the threshold grows, exponentially, with a larger one:
among 16,384 rows the largest swings are 3, 11 and 32 usual steps."""


def measure_usual_steps(steps: FloatArray) -> FloatArray:
    """Return the usual size of the steps of signals near each row.

    It is the upper quartile of a chunk, and the median of the steps that are not zero where few are not (counts of an
    encoder): the largest of those of the chunks nearby, since noise grows where a joint begins to move.

    Parameters
    ----------
    steps : (m, c)

    Returns
    -------
    (m, c)
    """
    m, c = steps.shape
    n = -(-m // CHUNK_ROWS)
    padded = np.full((n * CHUNK_ROWS, c), np.nan)
    np.abs(steps, out=padded[:m])
    # NaN is sorted to the end: the finite values of a chunk come first, and quantiles are entries.
    chunks = np.sort(padded.reshape(n, CHUNK_ROWS, c), axis=1)
    n_finite = np.isfinite(chunks).sum(axis=1)
    zeros = (chunks == 0.0).sum(axis=1)
    # Of fewer changes than these one corrupted sample would make its own measure.
    several = n_finite - zeros > 4
    at = np.maximum((3 * n_finite) // 4, np.where(several, (n_finite + zeros) // 2, 0))
    own = np.take_along_axis(chunks, np.minimum(at, np.maximum(n_finite - 1, 0))[:, None, :], axis=1)[:, 0]
    own = np.nan_to_num(own)
    near = own.copy()
    for shift in range(1, NEAR_CHUNKS + 1):
        np.maximum(near[shift:], own[:-shift], out=near[shift:])
        np.maximum(near[:-shift], own[shift:], out=near[:-shift])
    return np.repeat(near, CHUNK_ROWS, axis=0)[:m]


def measure_signal_steps(
    values: FloatArray, t: FloatArray, run: IntArray, smooth: BoolArray, periods: FloatArray
) -> FloatArray:
    """Return how far each row is off the row before it, and smooth signals off the line through the two rows before.

    Parameters
    ----------
    values : (m, c)
    t : (m,)
    run : (m,)
        Number of the stretch without a gap in time.
    smooth : (c,)
        Which signals are smooth.
    periods : (c,)
        Periods of wrapping angles, 0 of other signals.

    Returns
    -------
    (m, c)
        NaN at the first rows of a stretch.
    """
    first = np.full_like(values, np.nan)
    if len(values) < 3:
        return first
    first[1:] = np.diff(values, axis=0)
    for column in np.flatnonzero(periods):
        first[:, column] = fold_angles(first[:, column], float(periods[column]))
    first[1:][np.diff(run) != 0] = np.nan
    result = first
    if smooth.any():
        result = first.copy()
        spread = np.diff(t)
        with np.errstate(divide="ignore", invalid="ignore"):
            # Stamps jitter: the slope holds for a unit of time, not for a row.
            ratio = np.where(spread[:-1] > 0.0, spread[1:] / spread[:-1], 0.0)
        slope = first[1:-1][:, smooth] * ratio[:, None]
        second = first[2:][:, smooth] - slope
        result[:2, smooth] = np.nan
        result[2:, smooth] = second
    return result


def choose_step_threshold(steps: FloatArray, usual: FloatArray) -> float:
    """Return how many usual steps a sample of a signal has to be off to count as corrupted.

    A swing goes up and down again, or the other way round, as a single corrupted sample does; signals that often swing
    nearly as far by themselves have noise with heavy tails, and get a higher threshold.

    Parameters
    ----------
    steps, usual : (m,)

    Returns
    -------
    float
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])) / usual[:-1]
    middle = (size >= 0.5 * TIMES_USUAL) & (size < TIMES_USUAL) & (steps[:-1] * steps[1:] < 0.0)
    excess = np.count_nonzero(middle) / len(steps) - LIGHT_SHARE
    return float(TIMES_USUAL * np.exp(np.clip(TAIL_GROWTH * excess, 0.0, 20.0)))
