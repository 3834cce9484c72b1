"""The repair step that removes corrupted samples, signal by signal; spares reversals and coarse encoders.

Holds how far off a sample has to be to do harm; whether it is corrupted is decided in `corrupted_sample_detection`.

A bus that loses a frame, or a driver that answers late, gives zeros, largest values or old ones in single rows. One of
them in thousands is enough to spoil a model, since differentiation turns it into huge accelerations.
"""

from __future__ import annotations

import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.number_format import format_percent
from dynident.recordings.conditioning.angle_wrapping import TURN, find_wrapping_columns
from dynident.recordings.conditioning.corrupted_sample_detection import (
    LONGEST,
    MOMENT,
    SAME_VALUES,
    TIMES_USUAL,
    SignalSeries,
    choose_step_threshold,
    find_corrupted_samples,
    measure_signal_steps,
    measure_usual_steps,
)
from dynident.recordings.conditioning.windows_and_changed_rows import ChangedRows, Signals, Window
from dynident.recordings.recording_metadata import Check

LEAST_SHARE = {"smooth": 2e-4, "rough": 0.015}
"""Share of a signal's span (1 % to 99 % quantile) below which nothing is called corrupted: it could do no harm."""

LEAST_COUNTS = 6.0
"""Smallest steps of a signal that a sample has to be off: two or three counts of an encoder come and go."""

TURN_ROWS, TIMES_FRICTION = 3, 1.2
"""Rows on either side of where a joint turns round in which friction changes, and times its largest jump there that
it does not reach."""

ROUNDING = 1e-12
"""Share of a signal by which it changes through the rounding of numbers alone."""


class CorruptedSamples:
    """Removes samples that cannot have been measured: of positions, torques and the base's wrench."""

    name = "corrupted_samples"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._found = ChangedRows()
        self._least_sizes: dict[int, float] = {}
        self._lowest, self._highest = np.full((2, len(signals.needed)), np.nan)
        # Whatever a signal did before: there and back within two samples no joint is so fast.
        self._impossible = 2.0 * signals.fastest * signals.step

    def apply(self, window: Window) -> None:
        """Remove the corrupted samples of a window."""
        signals = self._signals
        needed = np.flatnonzero(signals.needed)
        values, smooth = window.values[:, needed], signals.smooth[needed]
        # At a wrap an angle jumps by a turn, which is no corruption: differences of such angles are folded.
        periods = np.where(find_wrapping_columns(window, signals)[needed], TURN, 0.0)
        steps = measure_signal_steps(values, window.t, window.run, smooth, periods)
        usual = measure_usual_steps(steps, smooth)
        impossible = np.where(smooth, self._impossible[needed], np.inf)
        # Of a signal whose usual steps are large, too, what no joint can do is large all the same.
        large = np.abs(steps) > np.minimum(TIMES_USUAL * usual, impossible)
        marks = np.zeros(values.shape, dtype=bool)
        for index, column in enumerate(needed.tolist()):
            # The full search is slow: only signals with large steps up and down again go through it.
            is_suspect = _comes_back(steps[:, index], np.flatnonzero(large[:, index]))
            # Which samples are found at all is measured once of every signal.
            if is_suspect or column not in self._least_sizes:
                course = self._describe_signal(window, column, steps[:, index], usual[:, index], periods[index])
                if is_suspect:
                    marks[find_corrupted_samples(course), index] = True
        clean = np.where(marks, np.nan, values)
        self._lowest[needed] = np.fmin(self._lowest[needed], np.fmin.reduce(clean, axis=0))
        self._highest[needed] = np.fmax(self._highest[needed], np.fmax.reduce(clean, axis=0))
        if not marks.any():
            return
        back = np.sign(steps) * large
        # Other torques that go up and down as well, uncorrupted, show that something has really happened.
        swings = np.asarray(
            (_mark_neighbours(back < 0.0) & _mark_neighbours(back > 0.0) & ~_mark_neighbours(marks))[:, ~smooth].any(
                axis=1
            )
        )
        for index in np.flatnonzero(marks.any(axis=0)).tolist():
            column = int(needed[index])
            rows = np.flatnonzero(marks[:, index])
            # Positions cannot jump. Torques can, where the robot is pushed or where friction changes its sign.
            if not smooth[index]:
                rows = rows[~self._find_explained_rows(window, column, rows, swings)]
            window.values[rows, column] = np.nan
            own = window.select_own_rows(rows)
            self._found.add(column, own, window.t[own - 1 - window.first_row])

    def checks(self) -> list[Check]:
        """Report which samples were removed."""
        rows, least = self._found, self._describe_least_sizes()
        if not rows.n:
            return [Check(self.name, "ok", f"No sample is an obvious outlier of its signal.{least}")]
        single = rows.n == 1
        detail = (
            f"{rows.n} sample{' is an obvious outlier' if single else 's are obvious outliers'} of "
            f"{'its signal' if single else 'their signals'} and cannot have been measured: "
            f"{rows.describe(self._signals.sources)}. {'It is' if single else 'They are'} interpolated between the "
            f"neighbours.{least} Look for lost frames of the bus; if the recorded values are right"
        )
        return [rows.warn_of_correction(self.name, detail, self._signals.sources)]

    def _describe_least_sizes(self) -> str:
        """Say from which size on samples are found, by the signal that has the most noise."""
        smooth, sizes = self._signals.smooth, []
        for of, kind in ((True, "position"), (False, "torque")):
            spans = {column: float(self._highest[column] - self._lowest[column]) for column in self._least_sizes}
            # What is not larger than the noise of a signal, such as that of a joint that rests, has no share.
            shares = {
                column: size / spans[column]
                for column, size in self._least_sizes.items()
                if smooth[column] == of and size < spans[column]
            }
            if shares:
                column = max(shares, key=shares.__getitem__)
                share = format_percent(shares[column], decimals=2 if of else 0)
                sizes.append(f"{share} of the range of a {kind} ({self._signals.sources[column]})")
        return f" A sample that is off by less than {' or '.join(sizes)} may pass for noise." if sizes else ""

    def _find_explained_rows(self, window: Window, column: int, rows: IntArray, swings: BoolArray) -> BoolArray:
        """Return which rows of a torque may have been measured after all.

        Those are rows without a value that stands in for lost samples, where other torques swing (m,) as well
        (something has happened to the robot), or where the joint reverses and the torque is no
        farther off than friction jumps there.
        """
        x = window.values[:, column].copy()
        # Zero, and any value that several suspects share, is what a driver writes for a lost sample: it is never
        # explained.
        values, counts = np.unique(x[rows], return_counts=True)
        stands_in = np.isin(x[rows], [0.0, *values[counts >= SAME_VALUES]])
        happened = _mark_neighbours(swings[:, None])[rows, 0]
        position = self._signals.position.get(column)
        if position is not None:
            turns, slow = _find_reversals(window.t, window.values[:, position])
            measured = x.copy()
            measured[rows] = np.nan
            # The jump of friction at a reversal, from some rows before it to some rows behind, without the suspects. It
            # is about the same at all of them; the inertia of fast moves adds to it at those where they begin or end.
            # Counts of an encoder that come and go are no reversals: nothing jumps there, so that jumps are weighed by
            # themselves in their mean.
            at = np.flatnonzero(turns[TURN_ROWS:-TURN_ROWS]) + TURN_ROWS
            jumps = np.zeros(len(x))
            jumps[at] = np.nan_to_num(np.abs(measured[at + TURN_ROWS] - measured[at - TURN_ROWS]))
            usual = float(jumps @ jumps) / max(float(jumps.sum()), np.finfo(float).tiny)
            moment = max(TURN_ROWS, round(MOMENT / self._signals.step))
            friction = np.maximum(scipy.ndimage.maximum_filter1d(jumps, 2 * moment + 1)[rows], usual)
            present = np.isfinite(measured)
            # How far off the suspects are is measured from a straight line between the samples that are no suspects.
            off = np.abs(x[rows] - np.interp(window.t[rows], window.t[present], measured[present]))
            # A joint that rests has no friction that changes, but just behind and before its last steps.
            near = _mark_neighbours(turns[:, None], TURN_ROWS)[:, 0]
            near |= slow & _mark_neighbours(turns[:, None], round(MOMENT / self._signals.step))[:, 0]
            happened |= near[rows] & (off < TIMES_FRICTION * friction)
        return np.asarray(happened & ~stands_in)

    def _describe_signal(
        self, window: Window, column: int, steps: FloatArray, usual: FloatArray, period: float
    ) -> SignalSeries:
        """Describe a signal by the smallest counts it comes in, its span, and the tails of its noise."""
        signals = self._signals
        x, smooth = window.values[:, column], bool(signals.smooth[column])
        finite = x[np.isfinite(x)]
        low, high = np.quantile(finite, (0.01, 0.99)) if len(finite) else (0.0, 0.0)
        changes = np.abs(np.diff(finite))
        changes = changes[changes > ROUNDING * max(abs(low), abs(high))]
        # Nearly the smallest change, which is a count of the encoder where the signal has counts.
        count = float(np.quantile(changes, 0.01)) if len(changes) else 0.0
        usual = np.maximum(usual, count)
        least = max(LEAST_COUNTS * count, LEAST_SHARE["smooth" if smooth else "rough"] * float(high - low))
        threshold = np.maximum(choose_step_threshold(steps, usual) * usual, least)
        if smooth:
            impossible = float(self._impossible[column])
            threshold, usual = np.minimum(threshold, impossible), np.minimum(usual, 0.25 * impossible)
        if len(finite):
            self._least_sizes[column] = max(float(np.median(threshold)), self._least_sizes.get(column, 0.0))
        return SignalSeries(window.t, x, window.run, usual, threshold, smooth, signals.step, period)


def _find_reversals(t: FloatArray, q: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Mark the rows where a joint reverses or starts or stops; and these together with its standstills."""
    turns, slow = np.zeros(len(q), dtype=bool), np.zeros(len(q), dtype=bool)
    finite = np.isfinite(q)
    if finite.any():
        direction = np.sign(np.diff(np.interp(t, t[finite], q[finite])))
        turns[1:-1] = direction[1:] != direction[:-1]
        slow[1:] = direction == 0.0
    return turns, slow | turns


def _comes_back(steps: FloatArray, large: IntArray) -> bool:
    """Return whether a signal with large steps in these rows soon goes up and down again, or down and up."""
    turns = np.diff(np.sign(steps[large])) != 0.0
    return bool((turns & (np.diff(large) <= LONGEST + 1)).any())


def _mark_neighbours(marks: BoolArray, rows: int = 1) -> BoolArray:
    """Mark the marked rows (m, c) and their neighbours."""
    result = marks.copy()
    for shift in range(1, rows + 1):
        result[shift:] |= marks[:-shift]
        result[:-shift] |= marks[shift:]
    return result
