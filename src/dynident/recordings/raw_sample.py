"""A bounded sample of the raw rows, as they were before resampling, for the checks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.file_source import RawRows
from dynident.recordings.recording import are_readings

MAX_ROWS = 1 << 18
STRETCHES = 16


@dataclass(frozen=True, eq=False)
class RawSample:
    """Raw rows in SI units from evenly spread stretches of a file.

    Parameters
    ----------
    row : (m,) of int
        Data rows of the file, counted from 1.
    t : (m,)
        Times in s.
    q, tau : (m, n)
        Positions in rad or m, and torques in N m or forces in N.
    dq : (m, n) or None
        Velocities in rad/s or m/s; None where the file gives none.
    joined : (m,) of bool
        True where a row directly follows the row before it in the file.
    used : (m,) of bool
        True inside the windows.
    """

    row: IntArray
    t: FloatArray
    q: FloatArray
    tau: FloatArray
    dq: FloatArray | None
    joined: BoolArray
    used: BoolArray


class SampleCollector:
    """Keeps all rows of a short recording, and evenly spread parts of a long one."""

    def __init__(self, n_rows: int, n: int, kinds: tuple[str, ...]) -> None:
        self._n = n
        self._dq = kinds.index("dq") * n if "dq" in kinds else None
        complete = n_rows <= MAX_ROWS
        length = n_rows if complete else MAX_ROWS // STRETCHES
        count = 1 if complete else STRETCHES
        starts = np.linspace(0, n_rows - length, count).astype(np.int64)
        self._stretches = [(int(start), int(start) + length) for start in starts]
        self._parts: list[tuple[IntArray, RawRows, BoolArray]] = []

    def feed(self, rows: RawRows, used: BoolArray) -> None:
        """Take the next rows and whether they lie in a window."""
        end = rows.first_row + len(rows.t)
        for start, stop in self._stretches:
            first, last = max(start, rows.first_row), min(stop, end)
            if first < last:
                part = slice(first - rows.first_row, last - rows.first_row)
                # Copies: a part of a block would keep all of it.
                rows_of_part = RawRows(first, rows.t[part].copy(), rows.segment[part].copy(), rows.values[part].copy())
                self._parts.append((np.arange(first + 1, last + 1), rows_of_part, used[part]))

    def result(self) -> RawSample:
        """Return the sample; rows without numbers are left out."""
        if not self._parts:
            nothing = np.empty((0, self._n))
            marks = np.empty(0, dtype=bool)
            return RawSample(np.empty(0, dtype=np.int64), np.empty(0), nothing, nothing, None, marks, marks)
        row = np.concatenate([numbers for numbers, _, _ in self._parts])
        t = np.concatenate([rows.t for _, rows, _ in self._parts])
        label = np.concatenate([rows.segment for _, rows, _ in self._parts])
        values = np.concatenate([rows.values for _, rows, _ in self._parts])
        used = np.concatenate([mark for _, _, mark in self._parts])
        joined = np.zeros(len(t), dtype=bool)
        joined[1:] = (np.diff(row) == 1) & (np.diff(label) == 0) & (np.diff(t) > 0)
        # Positions and torques come first among the columns; others may be missing.
        whole = np.all(are_readings(values[:, : 2 * self._n]), axis=1)
        joined[1:] &= whole[:-1]
        n = self._n
        dq = None if self._dq is None else values[whole, self._dq : self._dq + n]
        return RawSample(
            row[whole],
            t[whole],
            values[whole, :n],
            values[whole, n : 2 * n],
            dq,
            joined[whole],
            used[whole],
        )
