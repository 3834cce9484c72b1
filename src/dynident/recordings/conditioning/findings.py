"""Where something was found: rows by column, counted over all windows, in words for a message."""

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
class FoundRows:
    """Data rows, counted from 1, by column; of a column with very many only the first are kept, all are counted."""

    rows: dict[int, list[int]] = field(default_factory=dict)
    counts: dict[int, int] = field(default_factory=dict)
    first: tuple[int, float, int] | None = None

    def add(self, column: int, rows: IntArray, t: FloatArray) -> None:
        """Take the rows of a column, and the times of them."""
        if not len(rows):
            return
        listed = self.rows.setdefault(column, [])
        listed.extend(int(row) for row in rows[: KEPT_ROWS - len(listed)])
        self.counts[column] = self.counts.get(column, 0) + len(rows)
        earliest = int(rows[0]), float(t[0]), column
        self.first = earliest if self.first is None else min(self.first, earliest)

    @property
    def n(self) -> int:
        """How many samples were found in all columns together."""
        return sum(self.counts.values())

    def check(self, name: str, status: Status, detail: str, sources: Sequence[str]) -> Check:
        """Give the finding, by the user's names of the columns."""
        row, time, column = self.first or (None, None, None)
        rows = {sources[at]: tuple(numbers) for at, numbers in sorted(self.rows.items())}
        return Check(name, status, detail, "" if column is None else sources[column], row, time, rows=rows)

    def describe(self, sources: Sequence[str]) -> str:
        """Give the columns with their rows: "q2 (3, in rows 17, 118 and 240), tau4 (…)"."""
        parts = [
            f"{sources[column]} ({count} in row{'s' if count > 1 else ''} {_listed(self.rows[column], count)})"
            for column, count in sorted(self.counts.items())
        ]
        more = f" and {len(parts) - SHOWN_COLUMNS} more columns" if len(parts) > SHOWN_COLUMNS else ""
        return ", ".join(parts[:SHOWN_COLUMNS]) + more


def _listed(rows: Sequence[int], count: int) -> str:
    """Rows in words, consecutive ones as "17-19"."""
    edges = np.flatnonzero(np.diff(rows) != 1)
    starts, ends = [0, *(edges + 1)], [*edges, len(rows) - 1]
    spans = [str(rows[a]) if a == b else f"{rows[a]}-{rows[b]}" for a, b in zip(starts, ends, strict=True)]
    return ", ".join(spans[:SHOWN_ROWS]) + (", …" if len(spans) > SHOWN_ROWS or count > len(rows) else "")
