"""Rows that a log repeats or in which its drives are off: held samples and idle drives."""

from __future__ import annotations

import numpy as np

from dynident.recordings.conditioning.gap_bridging import bridge
from dynident.recordings.conditioning.signals import ChangedRows, Signals
from dynident.recordings.conditioning.windows import MARGIN_ROWS, Window, find_run_edges
from dynident.recordings.metadata import Check

SHORTEST = 0.5
"""s for which all torques have to be 0: no log loses frames for so long, and brakes take some tenths of a second."""

LEAST_JUMP = 0.1
"""Share of its span by which a torque jumps where drives are switched off or on; what comes to rest fades out."""


class IdleDrives:
    """Removes the torques of stretches in which all of them are exactly 0."""

    name = "idle_drives"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._found = ChangedRows()
        self._torques = np.array(sorted(signals.position))
        self._idle_until = -1

    def apply(self, window: Window) -> None:
        """Remove the torques of idle stretches in a window."""
        torques = window.values[:, self._torques]
        spans = np.ptp(np.nan_to_num(torques), axis=0)
        if not (spans > 0.0).any() and self._idle_until < window.first_row:
            # Nothing is known of these torques but 0: they were not recorded.
            return
        # No window may ask for a longer stretch than it can see: of one that reaches into its own rows that is as much
        # as its margin.
        shortest = min(MARGIN_ROWS // 2, max(2, round(SHORTEST / self._signals.step)))
        for start, stop in zip(*find_run_edges((torques == 0.0).all(axis=1)), strict=True):
            # A robot that comes to rest without load lets its torque fade out; drives that are switched make it jump.
            neighbours = [row for row in (start - 1, stop) if 0 <= row < len(torques)]
            jumps = np.abs(torques[neighbours]) > LEAST_JUMP * spans
            # A stretch that began in an earlier window need not jump again at the border of this one.
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
            return [Check(self.name, "ok", "The drives are switched on throughout.")]
        detail = (
            f"All torques are exactly 0 in {rows.n} rows, first in row {rows.first[0]} (t = {rows.first[1]:.6g} s), "
            "and jump there: the drives are switched off. These rows are not used, and nothing is filtered across "
            f'them; if the torques are right, say "skip": ["{self.name}"].'
        )
        return [rows.make_check(self.name, "warning", detail, self._signals.sources)]


LONGEST_HOLD = 0.2
"""s: signals that all stay the same for longer are those of a robot that stands."""

MOST_RESTS = 0.5
"""Share of a window's changes that have to come after a hold."""


class HeldSamples:
    """Interpolates between the true samples in place of repeated ones."""

    name = "held_samples"

    def __init__(self, signals: Signals) -> None:
        self._signals = signals
        self._found = ChangedRows()
        self._n_changes = 0
        self._n_rows = 0

    def apply(self, window: Window) -> None:
        """Replace repeated samples in a window in which all signals come in holds."""
        needed = np.flatnonzero(self._signals.needed)
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
            return
        # What stays the same for longer is a robot that stands, whose samples are true ones.
        for start, stop in zip(starts[~short], stops[~short], strict=True):
            same[start:stop] = False
        for column in needed:
            x = window.values[:, column]
            x[same] = np.nan
            bridge(window.t, x, window.run, longest, smooth=bool(self._signals.smooth[column]))
            # Before the second sample of a stretch, and behind the last but one, there is nothing to go by.
            unbridged = np.isnan(x)
            x[unbridged] = values[unbridged, np.flatnonzero(needed == column)[0]]
        own = window.select_own_rows(np.flatnonzero(same))
        self._n_rows += window.own.stop - window.own.start
        self._n_changes += window.own.stop - window.own.start - len(own)
        self._found.add(int(needed[0]), own, window.t[own - 1 - window.first_row])

    def checks(self) -> list[Check]:
        """Report at which rate samples really come."""
        rows = self._found
        if not rows.n:
            return [Check(self.name, "ok", "No signals are held between their samples.")]
        rate = 1.0 / self._signals.step
        detail = (
            f"In {rows.n} rows all positions and torques are those of the row before: the file has {rate:.4g} rows a "
            f"second, and what it holds comes about {rate * self._n_changes / self._n_rows:.3g} times a second. "
            "Between these samples the signals are interpolated; nothing faster can be seen in them. Log at the "
            f'rate of the source; if the rows are right as they are, say "skip": ["{self.name}"].'
        )
        return [rows.make_check(self.name, "warning", detail, self._signals.sources)]
