"""Detect single corrupted samples of one signal: blocks that leave its course and come back.

Holds how long a block may be (12 samples), and how far off it is compared with the usual steps; from which size on it
does harm is decided in `corrupted_sample_removal`.

A block of samples is off course if the signal goes on behind it as if nothing had been. How far off it has to be
depends on the signal's usual steps, on the tails of its noise and on how often it swings like that by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.conditioning.angle_wrapping import fold_angles
from dynident.recordings.conditioning.missing_and_held import interpolate_between
from dynident.recordings.conditioning.windows_and_changed_rows import CHUNK_ROWS, find_run_edges

NEAR_CHUNKS = 4
"""Chunks on either side of a chunk in which the usual step of a signal is looked for."""

TIMES_USUAL = 4.0
"""Times the usual step of a signal (its upper quartile nearby) that a sample has to be off: 7.6 standard deviations of
normal noise. `benchmarks/corrupted_samples.py` calibrates it, and the tails below."""

LIGHT_SHARE, TAIL_GROWTH = 0.002, 900.0
"""Share of rows in which noise swings by two to four usual steps: at most so many of normal noise (0.0009), 0.0035 of
Student's t with 5 degrees of freedom, 0.0075 with 3. And how the threshold grows, exponentially, with a larger one:
among 16,384 rows the largest swings are 3, 11 and 32 usual steps."""

FARTHEST = 40.0
"""Usual steps beyond which no noise swings. Where stamps come late, or samples are held, a signal swings in many rows
as well, but no farther than its joint moves meanwhile."""

FARTHER = 0.15
"""Share of these swings of noise, of Student's t with 3 degrees of freedom, that it has of four to eight usual steps
(the others have less)."""


def measure_usual_steps(steps: FloatArray, smooth: BoolArray) -> FloatArray:
    """Return the usual size of the steps of signals near each row.

    It is the upper quartile of a chunk, and the median of the steps that are not zero where few are not (counts of an
    encoder): the largest of those of the chunks nearby, since noise grows where a joint begins to move, and of smooth
    signals the second largest, or the largest in which they move.

    Parameters
    ----------
    steps : (m, c)
        Steps of c signals, NaN where there is none.
    smooth : (c,)
        Which signals are smooth.

    Returns
    -------
    (m, c)
        The usual step around each row.
    """
    m, c = steps.shape
    n = -(-m // CHUNK_ROWS)
    padded = np.full((n * CHUNK_ROWS, c), np.nan)
    padded[:m] = steps
    signed = padded.reshape(n, CHUNK_ROWS, c)
    # NaN is sorted to the end: the finite values of a chunk come first, and quantiles are entries.
    chunks = np.sort(np.abs(signed), axis=1)
    n_finite = np.isfinite(chunks).sum(axis=1)
    # The upper quartile of the finite entries.
    at = (3 * n_finite) // 4
    own = np.take_along_axis(chunks, np.minimum(at, np.maximum(n_finite - 1, 0))[:, None, :], axis=1)[:, 0]
    own = np.nan_to_num(own)
    # Corrupted samples that stand close together make the steps of one chunk large. A position that is corrupted there
    # spoils a model, while the noise of torques really may be large for one chunk only. So may a position's steps where
    # a joint moves or rings: they keep their sign from row to row, while a sample that is off makes them alternate.
    large = np.abs(signed) >= own[:, None]
    pairs = np.where(large[:, 1:] & large[:, :-1], signed[:, 1:] * signed[:, :-1], 0.0)
    moves = np.sign(pairs).sum(axis=1) > 0.0
    largest, second = own.copy(), np.where(moves, own, 0.0)
    for shift in range(1, min(NEAR_CHUNKS, n - 1) + 1):
        for here, there in ((slice(shift, None), slice(None, -shift)), (slice(None, -shift), slice(shift, None))):
            other = np.minimum(largest[here], own[there])
            second[here] = np.maximum(second[here], np.where(moves[there], own[there], other))
            largest[here] = np.maximum(largest[here], own[there])
    return np.repeat(np.where(smooth & (n > 1), second, largest), CHUNK_ROWS, axis=0)[:m]


def measure_signal_steps(
    values: FloatArray, t: FloatArray, run: IntArray, smooth: BoolArray, periods: FloatArray
) -> FloatArray:
    """Return how far each row is off the row before it, and smooth signals off the line through the two rows before.

    Parameters
    ----------
    values : (m, c)
        Values of c signals.
    t : (m,)
        Times in s.
    run : (m,)
        Number of the segment without a gap in time.
    smooth : (c,)
        Which signals are smooth.
    periods : (c,)
        Periods of wrapping angles, 0 of other signals.

    Returns
    -------
    (m, c)
        NaN at the first rows of a segment.
    """
    first = np.full_like(values, np.nan)
    if len(values) < 3:
        return first
    first[1:] = np.diff(values, axis=0)
    for column in np.flatnonzero(periods):
        first[:, column] = fold_angles(first[:, column], float(periods[column]))
    # Across a gap in time a step says nothing.
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
        Steps of one signal, and its usual step around each row.

    Returns
    -------
    float
        Number of usual steps, at least `TIMES_USUAL`.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        # A swing is as large as the smaller of its two steps: a single step does not come back.
        size = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])) / usual[:-1]
    size = size[steps[:-1] * steps[1:] < 0.0]
    middle, large = (np.count_nonzero((size >= k * TIMES_USUAL) & (size < 2.0 * k * TIMES_USUAL)) for k in (0.5, 1.0))
    # Corrupted samples of any size swing as often twice as far as in the middle. What noise adds there is a small share
    # of what it has in the middle, so that the two counts tell how much of the middle is noise.
    noise = np.clip((middle - large) / (1.0 - FARTHER), 0.0, middle)
    excess = noise / len(steps) - LIGHT_SHARE
    return float(TIMES_USUAL * np.exp(np.clip(TAIL_GROWTH * excess, 0.0, np.log(FARTHEST / TIMES_USUAL))))


LONGEST = 12
"""Samples in which a signal comes back to its course. What lasts longer could have happened."""

LONGEST_ROUGH = 8
"""The same of torques, which change faster than positions."""

MOMENT = 0.03
"""s in which no arm accelerates and brakes again."""

LATE_ROWS = 4
"""Rows on either side of a block whose stamps are looked at."""

BESIDE = (0.04, 0.12)
"""Share of what a torque is off by that the two samples before it, or behind it, may differ by, and a position's steps
there; and the inner two of a torque."""

MORE_THAN_SWINGS = 4.0
"""Times as many samples have to be off as the signal swings by half as much and back again of its own: what happens
often is measured, not corrupted."""

FEW, TIMES_FEW = 3, 2.5
"""Of fewer corrupted samples of a torque each has to be so many times farther off, or 0: noise has outliers, too."""

SAME_VALUES, SAME_SHARE = 3, 0.5
"""Corrupted samples of the very same value from which on it is known, and the share of them that may be uncertain."""


@dataclass(frozen=True, eq=False)
class SignalSeries:
    """One signal: x (m,) at t (m,), the number of the segment without a gap (run), and what is usual in it.

    `usual` (m,) is its usual step nearby, `threshold` (m,) how far off a sample has to be. A smooth signal is
    extrapolated along its slope. `step` is the usual step of time in s; `period` is that of a wrapping angle, 0 of any
    other signal.
    """

    t: FloatArray
    x: FloatArray
    run: IntArray
    usual: FloatArray
    threshold: FloatArray
    smooth: bool
    step: float
    period: float = 0.0

    def subtract(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """Return a - b, of wrapping angles the smallest one."""
        return fold_angles(a - b, self.period)

    def select_rows(self, rows: BoolArray) -> SignalSeries:
        """Return the same signal with these rows only."""
        parts = {name: getattr(self, name)[rows] for name in ("t", "x", "run", "usual", "threshold")}
        return replace(self, **parts)


def find_corrupted_samples(course: SignalSeries) -> IntArray:
    """Return the rows of a signal that are off its course, in ascending order.

    Parameters
    ----------
    course : SignalSeries
        The signal, and what is usual in it.

    Returns
    -------
    (k,) of int
        Indices of the rows.
    """
    unmarked = np.isfinite(course.x)
    sizes = np.zeros(len(course.x))
    # Without those that are known the course is plainer: others close to them come to light.
    for _ in range(3):
        rows = np.flatnonzero(unmarked)
        size = _measure_deviations(course.select_rows(unmarked))
        if not size.any():
            break
        sizes[rows] = size
        unmarked &= sizes == 0.0
    if not sizes.any():
        return np.empty(0, dtype=np.int64)
    # Candidates are corrupted only if they are many more than the swings of similar size that remain without them.
    certain = (sizes > 0.0) & (
        sizes >= _find_least_certain_size(sizes[sizes > 0.0], _measure_swings(course.select_rows(unmarked)))
    )
    # Noise of torque has outliers of its own. A few suspects have to stand out more clearly, or be exactly 0.
    if not course.smooth and len(find_run_edges(certain)[0]) < FEW:
        certain &= (sizes >= TIMES_FEW * course.threshold / course.usual) | (course.x == 0.0)
    return np.flatnonzero(certain | _mark_repeated_values(course, certain))


def _mark_repeated_values(course: SignalSeries, certain: BoolArray) -> BoolArray:
    """Mark samples with the very value of several corrupted ones, such as 0 or the largest count.

    Beside a step of the signal itself nothing else tells them.
    """
    values, counts = np.unique(course.x[certain], return_counts=True)
    stand_in = values[counts >= SAME_VALUES]
    again = np.isin(course.x, stand_in) & ~certain
    # A value that the signal often takes of its own says nothing.
    for value in stand_in:
        own = again & (course.x == value)
        if own.sum() > SAME_SHARE * (certain & (course.x == value)).sum():
            again &= ~own
    # Of a row of them the ends are off what is beside them.
    for start, stop in zip(*find_run_edges(again), strict=True):
        ends = [(start, start - 1), (stop - 1, stop)]
        steps = [abs(course.x[i] - course.x[k]) / course.usual[i] for i, k in ends if 0 <= k < len(again)]
        again[start:stop] = stop - start <= LONGEST and max(steps, default=0.0) > TIMES_USUAL
    return again


def _find_least_certain_size(sizes: FloatArray, swings: FloatArray) -> float:
    """Return the size above which a signal has clearly more corrupted samples than swings of its own."""
    descending = np.sort(sizes)[::-1]
    ascending = np.sort(swings)
    # For every candidate, largest first: how many swings are at least half as large?
    own = len(ascending) - np.searchsorted(ascending, 0.5 * descending)
    certain = np.flatnonzero(MORE_THAN_SWINGS * own <= np.arange(1, len(descending) + 1))
    return float(descending[certain[-1]]) if len(certain) else np.inf


def _measure_swings(course: SignalSeries) -> FloatArray:
    """Return the sizes, in usual steps, of moves off and back at once, as noise and controllers make them."""
    steps = _measure_steps(course)
    size = np.minimum(np.abs(steps[:-1]), np.abs(steps[1:])) / course.usual[:-1]
    swings = (steps[:-1] * steps[1:] < 0.0) & (size > TIMES_USUAL)
    if not course.smooth:
        # Beside a single jump of the signal, as of friction, a corrupted sample swings, too: noise does so from a
        # signal that moves on either side.
        quiet = np.abs(steps) <= 3.0 * course.usual
        swings[1:-1] &= ~(quiet[:-3] ^ quiet[3:])
    return np.asarray(size[swings])


def _measure_deviations(course: SignalSeries) -> FloatArray:
    """Return by how many usual steps samples are off course, 0 for all others.

    They come in blocks, of which the shortest are looked for first.
    """
    sizes = np.zeros(len(course.x))
    if len(course.x) < 5:
        return sizes
    # A block can only begin with a step that is larger than the threshold.
    starts = np.flatnonzero(np.abs(_measure_steps(course)) > course.threshold)
    for length in range(1, (LONGEST if course.smooth else LONGEST_ROUGH) + 1):
        if not len(starts):
            break
        for start, size in zip(*_find_blocks(course, starts, length), strict=True):
            # What a shorter block explains already, with the samples beside it, is no part of a longer one.
            if not sizes[max(0, start - 2) : start + length + 2].any():
                sizes[start : start + length] = size
        starts = starts[sizes[starts] == 0.0]
    return sizes


def _measure_steps(course: SignalSeries) -> FloatArray:
    """Return how far each sample is off the sample before it, or off the slope of the two before it."""
    steps = np.zeros(len(course.x))
    steps[1:] = course.subtract(course.x[1:], course.x[:-1])
    if course.smooth:
        spread = np.maximum(np.diff(course.t), 1e-12)
        # Two stamps may lie very close together: the slope between them is not carried on over more than ten such
        # steps.
        slope = steps[1:-1] * np.minimum(spread[1:] / spread[:-1], 10.0)
        steps[2:] = steps[2:] - slope
    steps[:2] = 0.0
    return steps


def _find_blocks(course: SignalSeries, starts: IntArray, length: int) -> tuple[IntArray, FloatArray]:
    """Return the starts (k,) of blocks that are off course, and by how much their samples (k, length) are."""
    t, x, run = course.t, course.x, course.run
    starts = starts[(starts >= 2) & (starts + length + 1 < len(x))]
    first = starts - (2 if course.smooth else LATE_ROWS)
    # A block and the samples around it have to lie within one segment without a gap.
    starts = starts[(first >= 0) & (run[np.maximum(first, 0)] == run[starts + length + 1])]
    if not len(starts):
        return starts, np.empty((0, length))
    # Two samples before the block and two behind it tell where the signal would have been inside.
    anchors = starts[:, None] + np.array([-2, -1, length, length + 1])
    at, usual = t[anchors], course.usual[starts]
    # Relative to the sample before the block: angles of many turns would lose digits.
    origin = x[starts - 1]
    anchor_values = course.subtract(x[anchors], origin[:, None])
    rows = starts[:, None] + np.arange(length)
    values, times = course.subtract(x[rows], origin[:, None]), t[rows]
    expected = interpolate_between(at, anchor_values, times, smooth=course.smooth)
    off = values - expected
    goes_on = _continues(course, at, anchor_values, usual, np.abs(off).min(axis=1), length)
    least = course.threshold[starts]
    around = np.clip(starts[:, None] + np.arange(-LATE_ROWS, length + LATE_ROWS), 0, len(t) - 1)
    uneven = np.abs(np.diff(t[around], axis=1) - course.step).max(axis=1)
    if course.smooth:
        speed = np.abs(anchor_values[:, 2] - anchor_values[:, 1]) / np.maximum(at[:, 2] - at[:, 1], 1e-12)
        # The longer a block is, the less exactly its samples are interpolated. And a stamp that comes late moves the
        # whole course by as much as the joint goes in that time.
        least = least * 0.5 * (length + 1) + 2.0 * speed * uneven
    far = np.abs(off) > least[:, None]
    is_off_course = goes_on & far[:, 0] & far[:, -1]
    if not course.smooth:
        # Where a row came late a controller has answered.
        is_off_course &= (np.abs(values[:, -1] - anchor_values[:, 2]) > least) & (uneven <= course.step)
        if length > 1:
            # A torque may well be another one for some samples, as where a joint accelerates. It then neither is the
            # very same in them, nor jumps from each to the next within a moment.
            inner = np.abs(np.diff(values, axis=1))
            jumps = ((inner == 0.0) | (inner > least[:, None])).all(axis=1)
            is_off_course &= (inner.max(axis=1) == 0.0) | (jumps & (length * course.step <= MOMENT))
    size = np.where(far, np.abs(off) / usual[:, None], 0.0)
    return starts[is_off_course], size[is_off_course]


def _continues(
    course: SignalSeries, t: FloatArray, x: FloatArray, usual: FloatArray, off: FloatArray, length: int
) -> BoolArray:
    """Return where two samples (k, 4) on either side of a block belong to one undisturbed course."""
    if course.smooth:
        # The slopes before, across and behind the block have to agree; how far they may differ grows with its length.
        slopes = np.diff(x, axis=1) / np.maximum(np.diff(t, axis=1), 1e-12)
        turns = np.abs(np.diff(slopes, axis=1)).max(axis=1) * course.step
        # Beside a jump that is many times larger a joint may well begin to move.
        return np.asarray(turns <= np.maximum(usual * (length + 2), BESIDE[0] * off))
    steps = np.abs(np.diff(x, axis=1))
    outer = np.maximum(steps[:, 0], steps[:, 2])
    # A torque may change while a block lasts: the longer it is, the farther apart its two sides may be.
    across = np.maximum(min(5.0, max(2.5, length + 1.0)) * usual, BESIDE[1] * off)
    return np.asarray((outer <= np.maximum(3.0 * usual, BESIDE[0] * off)) & (steps[:, 1] <= across))
