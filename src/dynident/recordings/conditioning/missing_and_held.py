"""Repair missing samples (short gaps are bridged), held or frozen ones, and drives that are off.

Holds the longest hold (0.2 s) and the most missing rows (30 %).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.conditioning.windows_and_changed_rows import (
    MARGIN_ROWS,
    ChangedRows,
    Signals,
    Window,
    find_run_edges,
)
from dynident.recordings.recording import are_readings
from dynident.recordings.recording_metadata import Check
from dynident.recordings.units import format_time

SHORTEST = 0.5
"""s for which all torques have to be 0: no log loses frames for so long, and brakes take some tenths of a second."""

LEAST_JUMP = 0.1
"""Share of its span by which a torque jumps where drives are switched off or on; what comes to rest fades out."""


class IdleDrives:
    """Removes the torques of intervals in which all of them are exactly 0."""

    name = "idle_drives"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._found = ChangedRows()
        self._torques = np.array(sorted(signals.position))
        self._idle_until = -1

    def apply(self, window: Window) -> None:
        """Remove the torques of idle intervals in a window."""
        torques = window.values[:, self._torques]
        spans = np.ptp(np.nan_to_num(torques), axis=0)
        if not (spans > 0.0).any() and self._idle_until < window.first_row:
            # Nothing is known of these torques but 0: they were not recorded.
            return
        # No window may ask for a longer interval than it can see: of one that reaches into its own rows that is as much
        # as its margin.
        shortest = min(MARGIN_ROWS // 2, max(2, round(SHORTEST / self._signals.step)))
        for start, stop in zip(*find_run_edges((torques == 0.0).all(axis=1)), strict=True):
            # A robot that comes to rest without load lets its torque fade out; drives that are switched make it jump.
            neighbours = [row for row in (start - 1, stop) if 0 <= row < len(torques)]
            jumps = np.abs(torques[neighbours]) > LEAST_JUMP * spans
            # An interval that began in an earlier window need not jump again at the border of this one.
            goes_on = start == 0 and self._idle_until >= window.first_row
            if stop - start < shortest or not (goes_on or jumps.any()):
                continue
            window.values[start:stop, self._torques] = np.nan
            # These rows are idle on purpose: they must not count as lost samples.
            window.unused[start:stop] = True
            self._idle_until = max(self._idle_until, window.first_row + int(stop) - 1)
            own = window.select_own_rows(np.arange(start, stop))
            self._found.add(int(self._torques[0]), own, window.t[own - 1 - window.first_row])

    def checks(self) -> list[Check]:
        """Report where the drives were switched off."""
        rows = self._found
        if not rows.n or rows.first is None:
            return [Check(self.name, "ok", "The drives are switched on all the time.")]
        detail = (
            f"All torques are exactly 0 in {rows.n} rows, first in row {rows.first[0]} "
            f"(t = {format_time(rows.first[1])} s), and they jump to 0 there: the drives are switched off. These rows "
            "are not used, and no filter runs across them. If the torques are right"
        )
        return [rows.warn_of_correction(self.name, detail, self._signals.sources)]


RARELY = 0.02
"""Share of a signal's other rows that may repeat the row before, where a longer repetition is no measurement."""

JUMPS = 5.0
"""Times its steps from row to row, the 1 % largest apart, that a position goes at once where it was frozen before."""

FEWEST_AWAY = 13
"""Rows for which a position that jumps away and back is the same; fewer are corrupted samples, which are mended."""

BENT = 0.003
"""rad or m off a straight line by which a joint surely speeds up or slows down: twice the count of a coarse encoder."""


class FrozenSignals:
    """Removes signals while they stay exactly the same although their joint moves, as where a bus loses them.

    Torques do so while those of other joints go on, and their own joint speeds up or slows down: of one that stands, or
    moves evenly, they may be constant. Positions jump at the end; those of joints that stand do not. Where they jump to
    another value as well, as encoders that read 0 for a moment, they are no measurement for however short a time.
    """

    name = "frozen_signals"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._found = ChangedRows()
        # Of columns that are the same across the border of two windows: since which row, and whether it is removed.
        self._going_on: dict[int, tuple[int, bool]] = {}
        self._late: list[str] = []

    def apply(self, window: Window) -> None:
        """Remove the frozen intervals of a window."""
        goes_on = (np.diff(window.run) == 0) & (np.diff(window.t) > 0.0)
        same = np.zeros(window.values.shape, dtype=bool)
        same[1:] = (np.diff(window.values, axis=0) == 0.0) & goes_on[:, None]
        shortest = min(MARGIN_ROWS // 2, max(10, round(SHORTEST / self._signals.step)))
        first_own, known, self._going_on = window.own.start, self._going_on, {}
        # Positions first: where one is lost, its torque that stays the same is lost, too.
        for column in (*self._signals.position.values(), *self._signals.position):
            starts, stops = find_run_edges(same[:, column])
            is_long = stops - starts >= shortest
            n_long = int((stops - starts)[is_long].sum())
            n_others = len(same) - n_long
            # Coarse signals repeat everywhere; of a window that is frozen as a whole the one before has told.
            is_fine = np.count_nonzero(same[:, column]) - n_long <= RARELY * n_others and n_others > shortest
            is_torque = column in self._signals.position
            is_frozen = self._is_frozen_torque if is_torque else self._is_frozen_position
            is_short = ~is_long & (stops - starts >= FEWEST_AWAY)
            if not is_torque and is_short.any():
                # A position that jumps away and back is none, however soon: the joint cannot have been there.
                is_long |= is_short & self._jumps_away(window, column, starts, stops)
            for start, stop in zip(starts[is_long].tolist(), stops[is_long].tolist(), strict=True):
                if stop - start < shortest:
                    start -= 1  # the first of the equal samples is as wrong as those that repeat it
                begin, removed = window.first_row + start, False
                if start == 1:
                    begin, removed = known.get(column, (begin, removed))
                is_late = not removed and begin < window.first_row + first_own
                if removed or (is_fine and is_frozen(window, same, column, start, stop)):
                    removed = True
                    window.values[start:stop, column] = np.nan
                    window.unused[start:stop] = True
                    own = window.select_own_rows(np.arange(start, stop))
                    self._found.add(column, own, window.t[own - 1 - window.first_row])
                    if is_late:
                        until = f"{window.first_row + first_own}, t = {format_time(window.t[first_own - 1])} s"
                        self._late.append(f"{self._signals.sources[column]} (rows {begin + 1} to {until})")
                if start <= window.own.stop - MARGIN_ROWS + 1 < stop:
                    self._going_on[column] = begin, removed

    def _is_frozen_torque(self, window: Window, same: BoolArray, column: int, start: int, stop: int) -> bool:
        x, position = window.values[:, column], self._signals.position[column]
        # Where all of them stay the same the robot stands; a torque at its end is saturated, and told as that.
        others = same[start:stop, list(self._signals.position)].mean(axis=0)
        if others.min() > RARELY or x[start] in (np.nanmin(x), np.nanmax(x)):
            return False
        t, q = window.t[start:stop], window.values[start:stop, position]
        known = np.isfinite(q)
        if not known.any():
            # Either the position was removed as frozen, or nobody knows whether the joint moves.
            return bool(same[start:stop, position].any())
        t, q = t[known], np.unwrap(q[known]) if self._signals.turning[position] else q[known]
        return float(np.abs(q - np.interp(t, t[[0, -1]], q[[0, -1]])).max()) > BENT

    def _is_frozen_position(self, window: Window, same: BoolArray, column: int, start: int, stop: int) -> bool:
        steps = self._compute_steps(window, column)
        return stop < len(same) and steps[stop - 1] > _find_far_step(steps)

    def _jumps_away(self, window: Window, column: int, starts: IntArray, stops: IntArray) -> BoolArray:
        """Return whether a position jumps at both ends of intervals in which it is the same."""
        steps = self._compute_steps(window, column)
        inner = (starts >= 2) & (stops <= len(steps))
        into, out_of = steps[np.where(inner, starts - 2, 0)], steps[np.where(inner, stops - 1, 0)]
        return np.asarray(inner & (np.minimum(into, out_of) > _find_far_step(steps)))

    def _compute_steps(self, window: Window, column: int) -> FloatArray:
        """Return the sizes (m - 1,) of a position's steps from row to row."""
        steps = np.diff(window.values[:, column])
        if self._signals.turning[column]:
            steps -= 2.0 * np.pi * np.rint(steps / (2.0 * np.pi))  # the border of an angle is no jump
        return np.where(np.diff(window.run) == 0, np.abs(steps), 0.0)

    def checks(self) -> list[Check]:
        """Report where signals were frozen."""
        rows = self._found
        if not rows.n or rows.first is None:
            return [Check(self.name, "ok", "No frozen signal was found.")]
        late = f" It showed too late to leave out {', '.join(self._late)}: exclude these." if self._late else ""
        detail = (
            f"{rows.n} samples, first in row {rows.first[0]} (t = {format_time(rows.first[1])} s), stay exactly the "
            f"same although the joint moves: {rows.describe(self._signals.sources)}. Old values were repeated, or a "
            f"drive was off. These rows are not used, and no filter runs across them.{late} If the values are right"
        )
        return [rows.warn_of_correction(self.name, detail, self._signals.sources)]


def _find_far_step(steps: FloatArray) -> float:
    """Return the step from row to row above which a position jumps."""
    moves = steps[steps > 0.0]
    return JUMPS * float(np.quantile(moves, 1.0 - RARELY / 2.0)) if len(moves) else np.inf


LONGEST_HOLD = 0.2
"""s: signals that all stay the same for longer are those of a robot that stands."""

MOST_RESTS = 0.5
"""Share of a window's changes that have to come after a hold."""

REGULAR = 0.8
"""Share of the holds of one kind of signal that have to last as long as their mean, to the row: a slower bus holds its
values so. Coarse digits do so only at constant speed, and then one joint changes at a time, by one digit."""


@dataclass
class _Held:
    """Columns that may hold their values together, the rows that do, and how many new values and rows there are."""

    columns: IntArray
    rows: ChangedRows = field(default_factory=ChangedRows)
    n_changes: int = 0
    n_rows: int = 0


class HeldSamples:
    """Interpolates between the true samples in place of repeated ones: of all signals, or of one kind on a slow bus."""

    name = "held_samples"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        needed, smooth = signals.needed, signals.smooth
        torques = needed & np.isin(np.arange(len(needed)), list(signals.position))
        self._held = {
            "positions and torques": _Held(np.flatnonzero(needed)),
            "torques": _Held(np.flatnonzero(torques)),
            "positions": _Held(np.flatnonzero(needed & smooth)),
        }

    def apply(self, window: Window) -> None:
        """Replace repeated samples in a window in which all signals, or all of one kind, come in holds."""
        for held in self._held.values():
            if self._replace_repeated(window, held):
                return

    def _replace_repeated(self, window: Window, held: _Held) -> bool:
        """Replace the repeated samples of some columns, and return whether there are any."""
        needed = held.columns
        values = window.values[:, needed]
        same = np.zeros(len(values), dtype=bool)
        # Rows that repeat the stamp, too, are left out elsewhere.
        same[1:] = (values[1:] == values[:-1]).all(axis=1) & (np.diff(window.run) == 0) & (np.diff(window.t) > 0.0)
        starts, stops = find_run_edges(same)
        longest = max(2, round(LONGEST_HOLD / self._signals.step))
        short = stops - starts <= longest
        changes = np.count_nonzero(~same)
        # Single repeated rows happen in any log of a coarse encoder: only a log whose changes mostly follow a hold is
        # one of held samples.
        if not len(starts) or np.count_nonzero(short) < MOST_RESTS * changes:
            return False
        if len(needed) < np.count_nonzero(self._signals.needed):
            lengths = np.diff(np.flatnonzero(~same))
            lengths = lengths[lengths <= longest + 1]
            if np.mean(np.abs(lengths - lengths.mean()) < 1.0) < REGULAR or _change_by_digits(values[~same]):
                return False
        # What stays the same for longer is a robot that stands, whose samples are true ones.
        for start, stop in zip(starts[~short], stops[~short], strict=True):
            same[start:stop] = False
        for column in needed:
            x = window.values[:, column]
            x[same] = np.nan
            bridge(window.t, x, window.run, longest, smooth=bool(self._signals.smooth[column]))
            # Before the second sample of an interval, and behind the last but one, there is nothing to go by.
            unbridged = np.isnan(x)
            x[unbridged] = values[unbridged, np.flatnonzero(needed == column)[0]]
        own = window.select_own_rows(np.flatnonzero(same))
        held.n_rows += window.own.stop - window.own.start
        held.n_changes += window.own.stop - window.own.start - len(own)
        held.rows.add(int(needed[0]), own, window.t[own - 1 - window.first_row])
        return True

    def checks(self) -> list[Check]:
        """Report at which rate samples really come."""
        rate = 1.0 / self._signals.step
        for what, held in self._held.items():
            if not held.rows.n:
                continue
            detail = (
                f"In {held.rows.n} rows all {what} repeat the row before: the file has {rate:.4g} rows a second, but "
                f"new values come only about {rate * held.n_changes / held.n_rows:.3g} times a second. The signals "
                "are interpolated between the new values; faster changes are lost. Log at the rate of the source. If "
                "the rows are right"
            )
            return [held.rows.warn_of_correction(self.name, detail, self._signals.sources)]
        return [Check(self.name, "ok", "No signal repeats its old value between new samples.")]


def _change_by_digits(values: FloatArray) -> bool:
    """Return whether columns change one at a time and mostly by their smallest step, as coarse encoders do."""
    steps = np.abs(np.diff(values, axis=0))
    changed = steps > 0.0
    if np.mean(np.count_nonzero(changed, axis=1) > 1) > 0.5:
        return False
    often = [x[x > 0.0] for x in steps.T if np.count_nonzero(x) > 0.5 * len(x)]
    return not any(np.median(x) > 1.5 * x.min() for x in often)


LONGEST_BRIDGE, FEWEST_ROWS = 0.03, 5
"""s, and at least so many rows, of missing samples that are bridged; of longer ones the rows are left out. At 0.3 rad
and 2 Hz a cubic through two positions on either side is off by 2.0e-5 rad across 0.03 s at 1 kHz, less than an encoder
of 17 bits resolves (4.8e-5 rad), and by 4.4e-4 rad across five rows at 100 Hz."""

MOST_MISSING = 0.3
"""Share of the rows without which a recording is not what it is said to be."""


class MissingValues:
    """Marks cells without a number, or with one that no sensor gives, as missing (NaN)."""

    name = "missing_values"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._found = ChangedRows()

    def apply(self, window: Window) -> None:
        """Mark the missing values in a window."""
        needed = np.flatnonzero(self._signals.needed)
        missing = ~are_readings(window.values[:, needed])
        for index in np.flatnonzero(missing.any(axis=0)):
            rows = np.flatnonzero(missing[:, index])
            window.values[rows, needed[index]] = np.nan
            own = window.select_own_rows(rows)
            self._found.add(int(needed[index]), own, window.t[own - 1 - window.first_row])

    def checks(self) -> list[Check]:
        """Report which cells were missing."""
        rows = self._found
        if not rows.n:
            return [Check(self.name, "ok", "Every cell that is needed has a valid number.")]
        detail = (
            f"{rows.n} cell{'s have' if rows.n > 1 else ' has'} no number, or one that no sensor gives: "
            f"{rows.describe(self._signals.sources)}. They are interpolated where valid neighbours are near; otherwise "
            "their rows are left out."
        )
        return [rows.make_check(self.name, "warning", detail, self._signals.sources)]


class BridgedGaps:
    """Interpolates over short intervals of missing samples."""

    name = "rows_left_out"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._found = ChangedRows()
        self._n_rows = 0
        self._n_lost = 0

    def apply(self, window: Window) -> None:
        """Bridge the short gaps in a window; readers leave out the rows that stay NaN."""
        signals = self._signals
        needed = np.flatnonzero(signals.needed)
        missing = np.isnan(window.values[:, needed])
        self._n_rows += window.own.stop - window.own.start
        if not missing.any():
            return
        # Seconds say what a motion allows; of slow logs five rows are bridged although they last longer.
        rows_bridged = max(FEWEST_ROWS, round(LONGEST_BRIDGE / signals.step))
        for index in np.flatnonzero(missing.any(axis=0)):
            column = int(needed[index])
            bridge(window.t, window.values[:, column], window.run, rows_bridged, smooth=bool(signals.smooth[column]))
            own = window.select_own_rows(np.flatnonzero(np.isnan(window.values[:, column]) & ~window.unused))
            self._found.add(column, own, window.t[own - 1 - window.first_row])
        # A row is lost if any needed signal is: the equations take all of them at the same instant.
        lost = np.isnan(window.values[window.own][:, needed]).any(axis=1) & ~window.unused[window.own]
        self._n_lost += int(lost.sum())

    def checks(self) -> list[Check]:
        """Report which rows are left out."""
        rows = self._found
        if not rows.n:
            return []
        detail = (
            f"{self._n_lost} of {self._n_rows} rows are left out, and no filter runs across them: samples are missing "
            f"there for too long to interpolate, in {rows.describe(self._signals.sources)}."
        )
        much = self._n_lost > MOST_MISSING * self._n_rows
        return [rows.make_check(self.name, "error" if much else "warning", detail, self._signals.sources)]


def bridge(t: FloatArray, x: FloatArray, run: IntArray, most: int, *, smooth: bool) -> None:
    """Interpolate, in place, over gaps of up to `most` missing samples.

    Parameters
    ----------
    t, x : (m,)
        Times in s, and one signal with NaN where samples are missing.
    run : (m,)
        Number of the segment without a gap in time that each row belongs to.
    most : int
        Largest number of samples that are missing in a row.
    smooth : bool
        Whether a cubic through two samples on either side is used, else a straight line.
    """
    missing = np.isnan(x)
    starts, ends = find_run_edges(missing)
    present = np.flatnonzero(~missing)
    # Gaps of one length at a time: all of them are then interpolated by one array operation.
    for length in range(1, most + 1):
        gap_starts = starts[ends - starts == length]
        before = np.searchsorted(present, gap_starts) - 1
        # A gap at the very beginning or end lacks two samples on one side, and stays open.
        inside = (before >= 1) & (before + 2 < len(present))
        gap_starts, before = gap_starts[inside], before[inside]
        if not len(gap_starts):
            continue
        anchors = present[before[:, None] + np.array([-1, 0, 1, 2])]
        # Across a gap in time nothing is bridged; farther anchors may lie beyond other missing samples.
        near = run[anchors[:, 0]] == run[anchors[:, 3]]
        gap_starts, anchors = gap_starts[near], anchors[near]
        rows = gap_starts[:, None] + np.arange(length)
        # Relative to a neighbour: angles of many turns would lose digits in Lagrange's products.
        origin = x[anchors[:, 1:2]]
        x[rows] = origin + interpolate_between(t[anchors], x[anchors] - origin, t[rows], smooth=smooth)


def interpolate_between(t: FloatArray, x: FloatArray, times: FloatArray, *, smooth: bool) -> FloatArray:
    """Interpolate between two samples before and two samples behind.

    Parameters
    ----------
    t, x : (k, 4)
        Times and values of the four samples.
    times : (k, l)
        Times in s at which to interpolate, l in each of the k gaps.
    smooth : bool
        Whether to use the cubic through all four (Lagrange), else a straight line between the inner two.

    Returns
    -------
    (k, l)
        The values at these times.
    """
    width = t[:, 2:3] - t[:, 1:2]
    # Logs that are written in bursts have several samples at one time: what lies between them is the first of them.
    share = np.divide(times - t[:, 1:2], width, out=np.zeros_like(times), where=width > 0)
    line = np.asarray(x[:, 1:2] + share * (x[:, 2:3] - x[:, 1:2]))
    apart = (np.diff(t, axis=1) > 0).all(axis=1)
    if not smooth or not apart.any():
        return line
    line[apart] = _interpolate_cubic(t[apart], x[apart], times[apart])
    return line


def _interpolate_cubic(t: FloatArray, x: FloatArray, times: FloatArray) -> FloatArray:
    result = np.zeros_like(times)
    # Lagrange's weights: each is one at its own sample and zero at the other three.
    for index in range(4):
        weight = np.ones_like(times)
        for other in range(4):
            if other != index:
                weight *= (times - t[:, other : other + 1]) / (t[:, index] - t[:, other])[:, None]
        result += weight * x[:, index : index + 1]
    return result
