"""Overlapping windows of rows that all repair steps work on, and the list of rows that they changed.

Holds how many changed rows are listed a column (1,000), and the impossible speed of a joint.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray, IntArray
from dynident.errors import Remedy
from dynident.recordings.columns_to_signals import Layout
from dynident.recordings.file_source import RawRows
from dynident.recordings.recording import JointLimits
from dynident.recordings.recording_metadata import Check, Status
from dynident.recordings.sampling_clock import TimeBase

CHUNK_ROWS = 64
"""Rows whose statistics are formed together. Windows begin at multiples of it: how a file is read changes nothing."""

WINDOW_ROWS, MARGIN_ROWS = 256 * CHUNK_ROWS, 16 * CHUNK_ROWS
"""Rows that a window decides on, and rows on either side that it only looks at: more than any step looks around."""


@dataclass(eq=False)
class Window:
    """Consecutive rows: t (m,), segment (m,) and values (m, c), which steps change in place; `raw` are those as read.

    `first_row` counts data rows from 0. `own` are the rows that this window decides on; the others belong to the
    windows beside it. `run` (m,) numbers the segments without a gap in time; `unused` (m,)
    are rows of which a step has said that nothing is to be learned from them.
    """

    first_row: int
    t: FloatArray
    segment: IntArray
    values: FloatArray
    raw: FloatArray
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
    # A gap, time that goes back, or another segment of the user ends a segment: no step of conditioning looks across.
    breaks = (steps > base.longest_step) | (steps < 0.0) | (np.diff(rows.segment) != 0)
    run = np.concatenate([[0], np.cumsum(breaks)]).astype(np.int64)
    unused = np.zeros(len(rows.t), dtype=bool)
    # A copy: what is read may be a view of the file's own memory, or be looked at again by the next window.
    values = np.array(rows.values, dtype=np.float64)
    return Window(
        first_row, rows.t, rows.segment, values, rows.values, slice(start - first_row, stop - first_row), run, unused
    )


def find_run_edges(marks: BoolArray) -> tuple[IndexArray, IndexArray]:
    """Return where runs of true marks begin, and the first row behind each."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], marks.astype(np.int8), [0]])))
    return edges[::2], edges[1::2]


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
        # A file that is corrupted throughout must not fill the memory with the numbers of its rows.
        listed.extend(int(row) for row in rows[: KEPT_ROWS - len(listed)])
        self.counts[column] = self.counts.get(column, 0) + len(rows)
        earliest = int(rows[0]), float(t[0]), column
        self.first = earliest if self.first is None else min(self.first, earliest)

    @property
    def n(self) -> int:
        """Number of samples in all columns together."""
        return sum(self.counts.values())

    def make_check(
        self, name: str, status: Status, detail: str, sources: Sequence[str], remedies: tuple[Remedy, ...] = ()
    ) -> Check:
        """Return the check that reports these rows.

        Parameters
        ----------
        name : str
            Of the check.
        status : "ok", "warning" or "error"
            Whether the recording may be used.
        detail : str
            The sentence for the user.
        sources : sequence of str
            The user's names of the columns.
        remedies : tuple of Remedy
            Those that the sentence quotes.

        Returns
        -------
        Check
            The check, with the place of the earliest row.
        """
        row, time, column = self.first or (None, None, None)
        rows = {sources[at]: tuple(numbers) for at, numbers in sorted(self.rows.items())}
        source = "" if column is None else sources[column]
        return Check(name, status, detail, source, row, time, rows=rows, remedies=remedies)

    def warn_of_correction(self, name: str, detail: str, sources: Sequence[str]) -> Check:
        """Return the warning that a step changed these rows, and how to leave the step out.

        Parameters
        ----------
        name : str
            Of the check and of the step of conditioning.
        detail : str
            The sentence for the user, up to "if the values are right".
        sources : sequence of str
            The user's names of the columns.

        Returns
        -------
        Check
            The warning.
        """
        remedy = Remedy("skip", (name,))
        return self.make_check(name, "warning", f"{detail}, state {remedy}.", sources, (remedy,))

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


FASTEST = 25.0
"""rad/s or m/s: no joint of an arm is faster (240 rpm), where its limit is not known."""

TIMES_LIMIT = 3.0
"""Times a joint's velocity limit that is impossible."""


@dataclass(frozen=True, eq=False)
class Signals:
    """The columns of values (m, c) that are read.

    `sources` are the user's names. `needed` (c,): those that have to hold numbers; `smooth` (c,): positions; `turning`
    (c,): angles; `fastest` (c,): speed in rad/s or m/s that is impossible, inf of what is no position; `limits`:
    position limits by column. `velocity`: the column of an angle's logged velocity.
    `position`: that of the position of a torque's joint. `factors`, `offsets` (c,): what made SI units of the file's
    numbers; `registers`: columns, by kind of signal, that may be registers. `servo_gains` (n,): torque over
    position error. `joints`: limits of the n joints.
    """

    sources: tuple[str, ...]
    needed: BoolArray
    smooth: BoolArray
    turning: BoolArray
    fastest: FloatArray
    limits: dict[int, tuple[float, float]]
    velocity: dict[int, int]
    position: dict[int, int]
    step: float
    factors: FloatArray
    offsets: FloatArray
    registers: dict[str, tuple[int, ...]]
    servo_gains: FloatArray | None
    joints: tuple[JointLimits, ...]

    @classmethod
    def from_layout(cls, layout: Layout, limits: tuple[JointLimits, ...], base: TimeBase) -> Signals:
        """Describe the columns of a layout."""
        kinds = [(kind, joint) for kind in layout.kinds for joint in range(len(getattr(layout, kind)))]
        positions = [kind in ("q", "q_command") for kind, _ in kinds]
        rates = layout.columns_of_kind("dq").start if layout.dq else None
        fastest = np.full(len(kinds), np.inf)
        ranges, velocity = {}, {}
        for column, (kind, joint) in enumerate(kinds):
            if not positions[column]:
                continue
            limit = limits[joint]
            # A stated limit may be exceeded for a moment: only several times as much is impossible.
            fastest[column] = FASTEST if limit.velocity is None else max(TIMES_LIMIT * limit.velocity, 1.0)
            if limit.position is not None:
                ranges[column] = limit.position
            if rates is not None and kind == "q":
                velocity[column] = rates + joint
        return cls(
            sources=tuple(column.source for column in layout.columns),
            needed=np.array([kind in ("q", "tau", "wrench") for kind, _ in kinds]),
            smooth=np.array(positions),
            turning=np.array(
                [
                    is_position and limits[joint].kind == "revolute"
                    for is_position, (_, joint) in zip(positions, kinds, strict=True)
                ]
            ),
            fastest=fastest,
            limits=ranges,
            velocity=velocity,
            position={layout.columns_of_kind("tau").start + joint: joint for joint in range(len(layout.tau))},
            step=base.typical,
            factors=np.array([column.factor for column in layout.columns]),
            offsets=np.array([column.offset for column in layout.columns]),
            registers={kind: _find_register_columns(kind, layout) for kind in ("q", "tau")},
            servo_gains=layout.servo_gains,
            joints=limits,
        )


def _find_register_columns(kind: str, layout: Layout) -> tuple[int, ...]:
    """Return the columns of a kind of signal that are the file's own numbers, but for their unit."""
    # In a sum of several columns no bits are left.
    if kind == "tau" and not layout.has_own_torque_columns:
        return ()
    silent = layout.without_torque if kind == "tau" else ()
    return tuple(layout.columns_of_kind(kind).start + j for j in range(len(layout.q)) if j not in silent)
