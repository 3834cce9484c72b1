"""Inner products straight from filtered rows, apart for rows where a joint moves and where it turns round.

A motion that is repeated shows the same again: whatever differs from the truth does so at the same place of every
period, and a function that is wrong but flexible predicts it in one period as well as in the next. So all that is at
one place of the period is one stretch, however often it was driven, and what is left out is other motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.products import Products, ProductStack, RowStack, Stack
from dynident.diagnosis.comparing.repeatability import Repeat, find_periods
from dynident.effects import ReferenceParameters, Signals
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.phases import Phase, compute_smear_width
from dynident.regressors.filtered_rows import FilteredSamples, stream_filtered_samples
from dynident.regressors.observation import Observation
from dynident.regressors.qr_accumulation import choose_block_length, compute_used_duration
from dynident.regressors.row_phases import RowPhases, find_joints_with_friction, shows_at_starts

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


_FINER = 0.25
"""Stretches are so much shorter than those that an identification keeps: the more there are, the surer is what gains in
most of them, as long as they are long against the filters' memory."""

_MOST = 160
"""Stretches in all: more make the test no sharper, and each holds products of all columns with each other."""

_KINDS = 3
"""Of rows: moving, turning, partial."""

_LONG = 2.0
"""Times the width that the filters smear to either side: what is in one stretch is then so little in the next that the
test keeps its level (`benchmarks/decision_level.py`)."""


@dataclass(frozen=True, eq=False)
class ConditionalRows:
    """Rows that are shown only to what lives there: `stacks`, their products, one a joint; `counts` (s, n).

    `shown` (columns, n): for which columns they are equations of which joint.
    """

    stacks: tuple[Stack, ...]
    counts: FloatArray
    shown: BoolArray


@dataclass(frozen=True, eq=False)
class PhasedProducts:
    """What all scores are computed from: `moving` of rows where the equation's joint moves.

    `turning`: where it turns round without sticking, shown to friction that remembers its path, or is about low speeds
    where it never sticks; `partial`: of the motion beside a halt, shown to friction that lives where a joint starts.
    """

    moving: Products
    turning: ConditionalRows
    partial: ConditionalRows

    def select_for_model(self, columns: Sequence[int] | IndexArray) -> Products:
        """The rows that are equations for a model with these columns."""
        return self._combine_rows(self.select_joints(columns))

    def select_for_candidates(self, columns: Sequence[int] | IndexArray, kinds: BoolArray) -> Products:
        """Those, and on all joints those of some kinds (2,): turning and partial rows, for candidates on any joint."""
        return self._combine_rows(self.select_joints(columns) | kinds[:, None])

    def count_rows(self, columns: Sequence[int] | IndexArray) -> FloatArray:
        """(s, n): how many rows are equations for a model with these columns."""
        turns, starts = self.select_joints(columns)
        return np.asarray(self.moving.counts + turns * self.turning.counts + starts * self.partial.counts)

    def select_joints(self, columns: Sequence[int] | IndexArray) -> BoolArray:
        """(2, n): joints whose turning, and whose partial rows are equations for a model with these columns."""
        own = np.asarray(columns, dtype=np.intp)
        return np.array([rows.shown[own].any(axis=0) for rows in (self.turning, self.partial)])

    def find_row_kinds(self, columns: Sequence[int] | IndexArray) -> tuple[bool, bool]:
        """Whether turning, and whether partial rows of any joint are equations for a model with these columns."""
        turns, starts = self.select_joints(columns)
        return bool(turns.any()), bool(starts.any())

    def _combine_rows(self, used: BoolArray) -> Products:
        """Rows in which each joint moves, and those of `used` (2, n): where it turns, and of motion beside a halt."""
        more = [
            [
                rows
                for rows, use in zip((self.turning, self.partial), own, strict=True)
                if use and rows.counts[:, j].any()
            ]
            for j, own in enumerate(used.T)
        ]
        if not any(more):
            return self.moving
        counts = self.moving.counts.copy()
        for j, own in enumerate(more):
            for rows in own:
                counts[:, j] += rows.counts[:, j]
        stacks = (
            (*plain, *(rows.stacks[j] for rows in own))
            for j, (plain, own) in enumerate(zip(self.moving.stacks, more, strict=True))
        )
        return Products(tuple(stacks), self.moving.position, counts, self.moving.run)


def gather_products(
    observation: Observation,
    signals: Signals,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    n_base: int,
    progress: Progress = ignore_progress,
    samples_of: Callable[[Recording], Iterable[FilteredSamples]] | None = None,
) -> PhasedProducts:
    """Inner products of all columns and Y, a stretch of time and joint at a time; W is never stored.

    Parameters
    ----------
    reference : ReferenceParameters
        What loads are predicted with.
    n_base : int
        Columns of the model itself: their friction says whose rows depend on the phase.
    samples_of : function, optional
        Gives a recording's filtered samples, where they are at hand.
    """
    n = observation.robot.n
    layout = [observation.joint_entries(joint) for joint in range(n)]
    frictional = find_joints_with_friction(observation, n_base)
    width = compute_smear_width(preprocessing, recordings[0].sampling_rate)
    total = sum(compute_used_duration(recording) for recording in recordings)
    usual = max(_FINER * choose_block_length(recordings), total / _MOST)
    repeats = [find_periods(recording) for recording in recordings]
    n_periodic = sum(1 + MANY * len(periods) for each in repeats for periods in each)
    stretches = BlockNumbering(usual, _LONG * width)
    collected = RowAccumulator([len(columns) for _, columns in layout], _KINDS, int(total / usual) + n_periodic)
    done, free = 0.0, np.ones(n, dtype=bool)
    for recording, periods in zip(recordings, repeats, strict=True):
        phases = RowPhases.from_recording(observation, recording, preprocessing, n_base).with_friction_of(frictional)
        free &= phases.free
        if samples_of is None:
            samples_of_recording: Iterable[FilteredSamples] = stream_filtered_samples(
                observation, recording, preprocessing, reference, phases=phases
            )
        else:
            samples_of_recording = samples_of(recording)
        segment = -1
        for samples in samples_of_recording:
            if samples.segment != segment:
                segment = samples.segment
                stretches.begin_run(recording.name_segment(segment), periods[segment])
            phase = phases.phases_at(segment, samples.t)
            partial_rows = phases.find_partial_rows(segment, samples.t, phase, samples.held)
            collected.push(
                stretches.number_times(samples.t),
                samples.stack_equations(layout),
                (phase == Phase.MOVING, phase == Phase.REVERSING, partial_rows),
            )
            progress(min(1.0, (done + samples.t[-1] - recording.segments[0].start_time) / total), recording.name)
        done += compute_used_duration(recording)
    starts = shows_at_starts(observation)
    turns = _find_memory_columns(observation, signals) | (starts & free)
    run = stretches.list_runs()
    (stacks, counts), turning, partial = collected.finish(len(run))
    position = tuple(_locate_columns(columns, observation.n_columns) for _, columns in layout)
    moving = Products(tuple((stack,) for stack in stacks), position, counts, run)
    return PhasedProducts(moving, ConditionalRows(*turning, turns), ConditionalRows(*partial, starts))


def _locate_columns(columns: IndexArray, count: int) -> IndexArray:
    """(count,): where each of all columns stands among those that a joint has, -1 where it lacks it."""
    where = np.full(count, -1, dtype=np.intp)
    where[columns] = np.arange(len(columns))
    return where


def _find_memory_columns(observation: Observation, signals: Signals) -> BoolArray:
    """(columns, n): which columns are functions of a joint's path."""
    has_memory = np.zeros((observation.n_columns, observation.robot.n), dtype=bool)
    if observation.memory:
        for k, column in enumerate(observation.columns):
            for signal in signals.find_memory_signals(column.torque):
                has_memory[k, list(observation.robot.get_position_movers(signal.joint))] = True
    return has_memory
