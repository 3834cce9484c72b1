"""Time that starts again within a file, where several runs were written one behind the other: each becomes a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from dynident.array_types import FloatArray, IntArray
from dynident.recordings.columns import Layout
from dynident.recordings.file_source import RawRows, RawSource
from dynident.recordings.metadata import Check

NEAR_BEGINNING = 0.1
"""Share of the time since a run began, from its beginning on, to which a clock goes back that starts again."""

FEWEST_STEPS = 20.0
"""Steps that such a clock goes back at least; rows that are exchanged go back by fewer."""


@dataclass
class RunLabels:
    """Numbers the runs of a file, block by block."""

    restarts: list[tuple[int, float, float]] = field(default_factory=list)
    """Data row, from 1, and the times before it and in it."""
    _begin: float = np.nan
    _last: float = np.nan
    _step: float = 0.0

    def label_rows(self, first_row: int, t: FloatArray) -> IntArray:
        """Return the number of the run of each row (m,), from 0."""
        labels = np.full(len(t), len(self.restarts), dtype=np.int64)
        if not len(t):
            return labels
        # Before the first row of all stands NaN: no comparison with it is true.
        before = np.concatenate([[self._last], t[:-1]])
        steps = t - before
        forward = steps[steps > 0.0]
        if not self._step and len(forward):
            self._step = float(np.median(forward))
        if np.isnan(self._begin):
            self._begin = float(t[0])
        for row in np.flatnonzero(steps < -FEWEST_STEPS * self._step):
            # Back to near the beginning of the run: rows that were only exchanged, or written late, go back less far.
            if t[row] <= self._begin + NEAR_BEGINNING * (before[row] - self._begin):
                self.restarts.append((first_row + int(row) + 1, float(before[row]), float(t[row])))
                self._begin = float(t[row])
                labels[row:] = len(self.restarts)
        self._last = float(t[-1])
        return labels


class RestartingSource:
    """A file whose rows are numbered by run where its time starts again and no column tells the runs apart."""

    def __init__(self, source: RawSource) -> None:
        self._source = source
        self._labels = RunLabels()

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Yield t and the runs alone; values are empty."""
        yield from self._label_blocks(self._source.times(layout), layout)

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Yield everything that the layout names."""
        yield from self._label_blocks(self._source.rows(layout), layout)

    def checks(self, column: str) -> list[Check]:
        """Report where the time started again, after its rows were read."""
        restarts = self._labels.restarts
        if not restarts:
            return []
        row, before, time = restarts[0]
        more = f", and later again ({len(restarts)} times in all)" if len(restarts) > 1 else ""
        return [
            Check(
                "time_restarts",
                "warning",
                f"Column {column} goes back from {before:.6g} to {time:.6g} s in row {row}{more}: read as "
                f"{len(restarts) + 1} runs, and nothing is filtered across their borders. A column `segment` of whole "
                "numbers tells runs apart, too.",
                column,
                row,
                time,
                rows={column: tuple(restart[0] for restart in restarts)},
            )
        ]

    def _label_blocks(self, blocks: Iterator[RawRows], layout: Layout) -> Iterator[RawRows]:
        # The file is read more than once: each pass counts anew.
        self._labels = RunLabels()
        for rows in blocks:
            labels = rows.segment if layout.segment is not None else self._labels.label_rows(rows.first_row, rows.t)
            yield rows._replace(segment=labels)
