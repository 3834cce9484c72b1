"""Rows of W and Y as they come, by stretch of time; where a stretch has many of them, their inner products."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.products import ProductStack, RowStack, Stack
from dynident.diagnosis.comparing.repetition import Repeat

MANY = 80
"""Stretches of a period, as of a short recording as a whole, where they are then long enough."""

_MOST_ROWS = 48
"""A stretch, on average, and joint. From about as many on as a usual model has columns, scores are read as quickly from
their products (`benchmarks/rows_or_products.py`), which then take less memory."""


class BlockNumbering:
    """Which stretch of time a row is of: of about a `usual` length in seconds, never below the `shortest`."""

    def __init__(self, usual: float, shortest: float) -> None:
        self._usual, self._shortest = max(usual, shortest), shortest
        self._now, self._end = 0, -np.inf
        self._runs: list[str] = []
        self._run = ""
        self._periods: Sequence[Repeat] = ()
        self._begun: dict[tuple[int, int], int] = {}

    def begin_run(self, label: str, periods: Sequence[Repeat]) -> None:
        """The next rows are of this run, which repeats itself where `periods` say; stretches end with it."""
        self._run, self._periods = label, periods
        self._begun = {}
        self._end = -np.inf

    def number_times(self, t: FloatArray) -> IndexArray:
        """(m,): the stretch of each of these times, which go on from those before."""
        numbers = np.zeros(len(t), dtype=np.intp)
        first = 0
        while first < len(t):
            if t[first] >= self._end:
                self._open_block(float(t[first]))
            last = first + max(1, int(np.searchsorted(t[first:], self._end)))
            numbers[first:last] = self._now
            first = last
        return numbers

    def list_runs(self) -> IndexArray:
        """(s,): which run every stretch is of, by number."""
        labels = list(dict.fromkeys(self._runs))
        return np.array([labels.index(label) for label in self._runs], dtype=np.intp)

    def _open_block(self, start: float) -> None:
        """Open the stretch that begins at a time or, where the motion has been here before, that of then."""
        for number, period in enumerate(self._periods):
            if period.start <= start < period.end + period.lag:
                length = max(self._shortest, min(self._usual, period.lag / MANY))
                length = period.lag / max(1, int(period.lag / length))
                since = (start - period.start) % period.lag
                place = int(since / length)
                self._end = start - since + (place + 1) * length
                self._now = self._begun.setdefault((number, place), len(self._runs))
                break
        else:
            self._end, self._now = start + self._usual, len(self._runs)
        if self._now == len(self._runs):
            self._runs.append(self._run)


class RowAccumulator:
    """Rows of every kind and joint, by stretch; as their products alone from where there are many.

    Parameters
    ----------
    widths : numbers of the joints' columns
    kinds : number of kinds
    expected : about so many stretches
    """

    def __init__(self, widths: Sequence[int], kinds: int, expected: int) -> None:
        self._heaps = [[_JointAccumulator(width + 1, max(expected, 1)) for width in widths] for _ in range(kinds)]
        self._room, self._pending, self._folded = _MOST_ROWS * max(expected, 1), 0, False

    def push(self, stretch: IndexArray, rows: Sequence[FloatArray], used: Sequence[BoolArray]) -> None:
        """Add [W | Y] (m, p + 1) of every joint, in their stretches (m,); `used` (m, n) of every kind."""
        for heaps, mask in zip(self._heaps, used, strict=True):
            for heap, block, own in zip(heaps, rows, mask.T, strict=True):
                heap.push(stretch[own], block if own.all() else block[own])
        self._pending += len(stretch)
        if self._pending > self._room:
            self._fold()

    def finish(self, n_stretches: int) -> list[tuple[tuple[Stack, ...], FloatArray]]:
        """The stacks of all joints, and how many rows there are (s, n), for every kind."""
        if self._folded:
            self._fold()
        return [
            (
                tuple(heap.stack(n_stretches) for heap in heaps),
                np.stack([heap.counts(n_stretches) for heap in heaps], axis=1),
            )
            for heaps in self._heaps
        ]

    def _fold(self) -> None:
        self._pending, self._folded = 0, True
        for heaps in self._heaps:
            for heap in heaps:
                heap.fold()


class _JointAccumulator:
    """Rows (m, w) of one kind and joint: those that are pending, and the products of those before."""

    def __init__(self, width: int, expected: int) -> None:
        self._width, self._expected = width, expected
        self._rows: list[FloatArray] = []
        self._stretch: list[IndexArray] = []
        self._products: FloatArray | None = None
        self._counts = np.zeros(0)

    def push(self, stretch: IndexArray, rows: FloatArray) -> None:
        if len(rows):
            self._rows.append(rows)
            self._stretch.append(stretch)
            self._count(stretch)

    def _count(self, stretch: IndexArray) -> None:
        counts = np.bincount(stretch, minlength=len(self._counts)).astype(np.float64)
        counts[: len(self._counts)] += self._counts
        self._counts = counts

    def fold(self) -> None:
        """Products instead of the pending rows."""
        if self._products is None:
            self._products = np.zeros((0, self._width, self._width))
        rows, stretch = self._pop_pending()
        # Room is made for all at once: zeros that nobody has written to take no memory.
        last = int(stretch[-1]) if len(stretch) else -1
        if len(self._products) <= last:
            self._products = _resize(self._products, max(2 * len(self._products), last + 1, self._expected))
        edges = np.flatnonzero(np.diff(stretch)) + 1
        for own, part in zip(np.split(stretch, edges), np.split(rows, edges), strict=True):
            if len(own):
                self._products[own[0]] += part.T @ part

    def stack(self, n_stretches: int) -> Stack:
        """All of it."""
        if self._products is not None:
            return ProductStack(_resize(self._products, n_stretches))
        rows, stretch = self._pop_pending()
        return RowStack(rows, stretch, n_stretches)

    def counts(self, n_stretches: int) -> FloatArray:
        """(s,): rows of every stretch."""
        return np.pad(self._counts, (0, n_stretches - len(self._counts)))

    def _pop_pending(self) -> tuple[FloatArray, IndexArray]:
        """The pending rows and their stretches, ascending; none are pending any more."""
        rows, stretch = self._rows, self._stretch
        self._rows, self._stretch = [], []
        if not rows:
            return np.zeros((0, self._width)), np.zeros(0, dtype=np.intp)
        together, each = np.concatenate(rows), np.concatenate(stretch)
        order = np.argsort(each, kind="stable")
        return together[order], each[order]


def _resize(stack: FloatArray, length: int) -> FloatArray:
    """(length, ...): the first of a stack, or the stack with zeros behind it."""
    if len(stack) >= length:
        return stack[:length]
    longer = np.zeros((length, *stack.shape[1:]))
    longer[: len(stack)] = stack
    return longer
