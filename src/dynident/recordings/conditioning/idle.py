"""Idle drives: stretches in which torques read exactly 0 while brakes hold the joints."""

from __future__ import annotations

import numpy as np

from dynident.recordings.conditioning.findings import ChangedRows
from dynident.recordings.conditioning.signals import Signals
from dynident.recordings.conditioning.windows import MARGIN_ROWS, Window, find_run_edges
from dynident.recordings.types import Check

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
        shortest = min(MARGIN_ROWS // 2, max(2, round(SHORTEST / self._signals.step)))
        for start, stop in zip(*find_run_edges((torques == 0.0).all(axis=1)), strict=True):
            neighbours = [row for row in (start - 1, stop) if 0 <= row < len(torques)]
            jumps = np.abs(torques[neighbours]) > LEAST_JUMP * spans
            # A stretch that began in an earlier window need not jump again at the border of this one.
            goes_on = start == 0 and self._idle_until >= window.first_row
            if stop - start < shortest or not (goes_on or jumps.any()):
                continue
            window.values[start:stop, self._torques] = np.nan
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
