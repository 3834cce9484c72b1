"""Which rows a step of conditioning has changed: by column, counted over all windows, in words for a message."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dynident.arrays import FloatArray, IntArray
from dynident.recordings.types import Check, Status

SHOWN_ROWS, SHOWN_COLUMNS = 8, 12
KEPT_ROWS = 1000
"""Rows of a column that are kept; more are only counted."""


@dataclass
class ChangedRows:
    """Data rows by column, counted from 1; of a column with very many only the first are listed, all are counted.

    `first` is the earliest of them: its row, its time in s and its column.
    """

    rows: dict[int, list[int]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    first: tuple[int, float, int] | None = None

    def add(self, column: int, rows: IntArray, t: FloatArray) -> None:
        """Add rows of a column, and their times."""
        if not len(rows):
            return
        listed = self.rows.setdefault(column, [])
        listed.extend(int(row) for row in rows[: KEPT_ROWS - len(listed)])
        self.counts[column] = self.counts.get(column, 0) + len(rows)
        earliest = int(rows[0]), float(t[0]), column
        self.first = earliest if self.first is None else min(self.first, earliest)

    @property
    def n(self) -> int:
        """Number of samples in all columns together."""
        return sum(self.counts.values())

    def make_check(self, name: str, status: Status, detail: str, sources: Sequence[str]) -> Check:
        """Return the check that reports these rows.

        Parameters
        ----------
        name : str
            Of the check.
        status : "ok", "warning" or "error"
        detail : str
        sources : sequence of str
            The user's names of the columns.

        Returns
        -------
        Check
        """
        row, time, column = self.first or (None, None, None)
        rows = {sources[at]: tuple(numbers) for at, numbers in sorted(self.rows.items())}
        return Check(name, status, detail, "" if column is None else sources[column], row, time, rows=rows)

    def describe(self, sources: Sequence[str]) -> str:
        """Return the columns with their rows in words: "q2 (3, in rows 17, 118 and 240), tau4 (…)"."""
        parts = [
            f"{sources[column]} ({count} in row{'s' if count > 1 else ''} {_format_rows(self.rows[column], count)})"
            for column, count in sorted(self.counts.items())
        ]
        more = f" and {len(parts) - SHOWN_COLUMNS} more columns" if len(parts) > SHOWN_COLUMNS else ""
        return ", ".join(parts[:SHOWN_COLUMNS]) + more


def _format_rows(rows: Sequence[int], count: int) -> str:
    """Return rows in words, consecutive ones as "17-19"."""
    edges = np.flatnonzero(np.diff(rows) != 1)
    starts, ends = [0, *(edges + 1)], [*edges, len(rows) - 1]
    spans = [str(rows[a]) if a == b else f"{rows[a]}-{rows[b]}" for a, b in zip(starts, ends, strict=True)]
    return ", ".join(spans[:SHOWN_ROWS]) + (", …" if len(spans) > SHOWN_ROWS or count > len(rows) else "")
