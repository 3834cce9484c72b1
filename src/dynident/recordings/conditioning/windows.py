"""Overlapping windows over the rows of a recording, so that every row is seen together with those around it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray, IntArray
from dynident.recordings.file_source import RawRows
from dynident.recordings.timebase import TimeBase

CHUNK_ROWS = 64
"""Rows whose statistics are formed together. Windows begin at multiples of it: how a file is read changes nothing."""

WINDOW_ROWS, MARGIN_ROWS = 256 * CHUNK_ROWS, 16 * CHUNK_ROWS
"""Rows that a window decides on, and rows on either side that it only looks at: more than any step looks around."""


@dataclass(eq=False)
class Window:
    """Consecutive rows: t (m,), segment (m,) and values (m, c), which steps change in place.

    `first_row` counts data rows from 0. `own` are the rows that this window decides on; the others belong to the
    windows beside it. `run` (m,) numbers the stretches without a gap in time; `unused` (m,)
    are rows of which a step has said that nothing is to be learned from them.
    """

    first_row: int
    t: FloatArray
    segment: IntArray
    values: FloatArray
    own: slice
    run: IntArray
    unused: BoolArray

    def select_own_rows(self, rows: IntArray) -> IntArray:
        """Return those of the given rows that this window decides on, as data rows counted from 1."""
        inside = rows[(rows >= self.own.start) & (rows < self.own.stop)]
        return np.asarray(inside + self.first_row + 1)


def cut_into_windows(blocks: Iterable[RawRows], base: TimeBase) -> Iterator[Window]:
    """Cut rows that come in blocks of any size into windows of one size.

    Parameters
    ----------
    blocks : iterable of RawRows
        In order.
    base : TimeBase
        Tells what step of time is a gap.

    Yields
    ------
    Window
        Together, their own rows are all rows, each once.
    """
    waiting: list[RawRows] = []
    first_row = next_row = end = 0
    for block in blocks:
        waiting.append(block)
        end += len(block.t)
        # A window is complete once the margin behind its own rows is there, too.
        while end >= next_row + WINDOW_ROWS + MARGIN_ROWS:
            joined = _join_blocks(waiting)
            stop = next_row + WINDOW_ROWS
            yield _make_window(
                _cut_rows(joined, first_row, first_row, stop + MARGIN_ROWS), first_row, next_row, stop, base
            )
            # The rows in front of the next window's own rows are kept: it looks at them, but does not decide on them
            # again.
            waiting = [_cut_rows(joined, first_row, stop - MARGIN_ROWS, end)]
            first_row, next_row = stop - MARGIN_ROWS, stop
    if end > next_row:
        yield _make_window(_join_blocks(waiting), first_row, next_row, end, base)


def _join_blocks(blocks: list[RawRows]) -> RawRows:
    if len(blocks) == 1:
        return blocks[0]
    return RawRows(blocks[0].first_row, *(np.concatenate(parts) for parts in list(zip(*blocks, strict=True))[1:]))


def _cut_rows(rows: RawRows, first_row: int, start: int, stop: int) -> RawRows:
    part = slice(start - first_row, stop - first_row)
    return RawRows(start, rows.t[part], rows.segment[part], rows.values[part])


def _make_window(rows: RawRows, first_row: int, start: int, stop: int, base: TimeBase) -> Window:
    steps = np.diff(rows.t)
    # A gap, time that goes back, or another segment of the user ends a stretch: no step of conditioning looks across.
    breaks = (steps > base.longest_step) | (steps < 0.0) | (np.diff(rows.segment) != 0)
    run = np.concatenate([[0], np.cumsum(breaks)]).astype(np.int64)
    unused = np.zeros(len(rows.t), dtype=bool)
    # A copy: what is read may be a view of the file's own memory, or be looked at again by the next window.
    values = np.array(rows.values, dtype=np.float64)
    return Window(first_row, rows.t, rows.segment, values, slice(start - first_row, stop - first_row), run, unused)


def find_run_edges(marks: BoolArray) -> tuple[IndexArray, IndexArray]:
    """Return where runs of true marks begin, and the first row behind each."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marks.astype(np.int8), [0]])))
    return edges[::2], edges[1::2]
