"""Accumulate inner products of W, candidates and Y from recordings, block by block and by phase of the joint.

Holds how long the blocks of time of the folds are, and how many there are at most.

A motion that is repeated shows the same again: whatever differs from the truth does so at the same place of every
period, and a function that is wrong but flexible predicts it in one period as well as in the next. So all that is at
one place of the period is one block, however often it was driven, and what is left out is other motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.time_blocks_and_folds import (
    KINDS,
    MOST_PRODUCTS,
    Products,
    ProductStack,
    RowStack,
    Stack,
    number_folds,
    order_by_folds,
    split_runs,
)
from dynident.diagnosis.comparison.repeated_motion import Repeat, find_periods
from dynident.effects import Signals
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Recording
from dynident.recordings.joint_phases import Phase, compute_smear_width
from dynident.regressors.dynamic_model_rows import FilteredSamples, stream_behind_kept_rows
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.qr_accumulation import choose_block_length, compute_used_duration
from dynident.regressors.row_phases import RowPhases, find_joints_with_friction, remembers_path, shows_at_starts

MANY = 80
"""Blocks of a period, as of a short recording as a whole, where they are then long enough."""


_MOST_ROWS = 48
"""A block, on average, and joint. From about as many on as a usual model has columns, scores are read more quickly from
their products (`benchmarks/rows_or_products.py`)."""


class BlockNumbering:
    """Numbers of the blocks of time that rows are in.

    Parameters
    ----------
    usual : float
        Usual length of a block, s.
    shortest : float
        Least length of a block, s.
    """

    def __init__(self, usual: float, shortest: float) -> None:
        self._usual, self._shortest = max(usual, shortest), shortest
        self._now, self._end = 0, -np.inf
        self._runs: list[str] = []
        self._run = ""
        self._periods: Sequence[Repeat] = ()
        self._begun: dict[tuple[int, int], int] = {}

    def begin_run(self, label: str, periods: Sequence[Repeat]) -> None:
        """Begin a run: the rows that follow are of it, and blocks end with it."""
        self._run, self._periods = label, periods
        # The places of a period are those of one run: the next run may have another motion.
        self._begun = {}
        # A new run begins a new block, whatever its time.
        self._end = -np.inf

    def number_times(self, t: FloatArray) -> IndexArray:
        """Return the number (m,) of the block that each of these times is in; they continue those of the last call."""
        numbers = np.zeros(len(t), dtype=np.intp)
        first = 0
        while first < len(t):
            if t[first] >= self._end:
                self._open_block(float(t[first]))
            # At least one row a turn of the loop, also where rounding puts the end of the block at the row itself.
            last = first + max(1, int(np.searchsorted(t[first:], self._end)))
            numbers[first:last] = self._now
            first = last
        return numbers

    def list_runs(self) -> IndexArray:
        """Return the number (s,) of the run that each block is of."""
        labels = list(dict.fromkeys(self._runs))
        return np.array([labels.index(label) for label in self._runs], dtype=np.intp)

    def _open_block(self, start: float) -> None:
        """Open the block that begins at a time or, where the motion has been here before, the block of that time."""
        # Within a repeated interval the block depends on the place in the period, not on which period it is.
        for number, period in enumerate(self._periods):
            if period.start <= start < period.end + period.lag:
                length = max(self._shortest, min(self._usual, period.lag / MANY))
                # The period is divided into equal blocks, so that the same place of every period has the same number.
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
    """Collects the rows of every kind and joint by block; as their products alone from where there are many.

    Parameters
    ----------
    widths : sequence of int
        Number of columns of each joint.
    kinds : int
        Number of kinds of rows.
    expected : int
        Expected number of blocks.
    """

    def __init__(self, widths: Sequence[int], kinds: int, expected: int) -> None:
        expected = max(expected, 1)
        is_large = sum((width + 1) ** 2 for width in widths) * expected > MOST_PRODUCTS
        number = np.dtype(np.float32 if is_large else np.float64)
        self._joints = [[_JointAccumulator(width + 1, expected, number) for _ in range(kinds)] for width in widths]
        # A block of more rows than columns has fewer products.
        self._capacities = [max(_MOST_ROWS, is_large * (width + 1)) * expected for width in widths]

    def push(self, row_block: IndexArray, columns: Iterable[FloatArray], used: Sequence[BoolArray]) -> None:
        """Add rows of every joint, given column by column (p_j + 1, m): those of each kind (m, n) that are used."""
        for j, (kinds, block) in enumerate(zip(self._joints, columns, strict=True)):
            for heap, mask in zip(kinds, used, strict=True):
                # A joint moves and stands for many rows: spans of these are copied at once.
                for is_used, rows in split_runs(mask[:, j].astype(np.intp)):
                    if is_used:
                        heap.push(row_block[rows], block[:, rows])
            # Folding bounds the memory by the size of the products, however long the recordings are.
            if sum(heap.n_pending for heap in kinds) > self._capacities[j]:
                _fold_kinds(kinds)

    def finish(self, order: IndexArray) -> list[tuple[tuple[Stack, ...], FloatArray]]:
        """Return the stacks of all joints and the numbers of rows (s, n), for every kind.

        Parameters
        ----------
        order : (s,)
            All blocks, in the order in which rows are stored.
        """
        for kinds in self._joints:
            # Once one kind of a joint is folded all are: a stack is either rows or products.
            if any(heap.is_folded for heap in kinds):
                _fold_kinds(kinds)
        return [
            (
                tuple(heap.stack(order) for heap in heaps),
                np.stack([heap.counts(len(order)) for heap in heaps], axis=1),
            )
            for heaps in zip(*self._joints, strict=True)
        ]


def _fold_kinds(kinds: Sequence[_JointAccumulator]) -> None:
    for heap in kinds:
        heap.fold()


class _JointAccumulator:
    """Rows of one kind and joint: those that are pending, column by column, and the products of those before."""

    def __init__(self, width: int, expected: int, number: np.dtype[Any]) -> None:
        self._expected = expected
        # Grows as rows come: pieces that are joined at the end would take twice the memory.
        self._columns = np.empty((width, 0), dtype=number)
        self._row_block: list[IndexArray] = []
        self._products: FloatArray | None = None
        self._counts = np.zeros(0)
        self.n_pending = 0

    @property
    def is_folded(self) -> bool:
        """Whether any rows were replaced by their products."""
        return self._products is not None

    def push(self, row_block: IndexArray, columns: FloatArray) -> None:
        first, last = self.n_pending, self.n_pending + len(row_block)
        if last > self._columns.shape[1]:
            longer = np.empty((len(self._columns), max(2 * first, last)), dtype=self._columns.dtype)
            longer[:, :first] = self._columns[:, :first]
            self._columns = longer
        self._columns[:, first:last] = columns
        self._row_block.append(row_block)
        self._count(row_block)
        self.n_pending = last

    def _count(self, row_block: IndexArray) -> None:
        counts = np.bincount(row_block, minlength=len(self._counts)).astype(np.float64)
        counts[: len(self._counts)] += self._counts
        self._counts = counts

    def fold(self) -> None:
        """Replace the pending rows by their products."""
        width = len(self._columns)
        if self._products is None:
            self._products = np.zeros((0, width, width))
        columns, row_block = self._pop_pending(np.arange(len(self._counts)))
        # Room is made for all at once: zeros that nobody has written to take no memory.
        last = int(row_block[-1]) if len(row_block) else -1
        if len(self._products) <= last:
            self._products = _resize(self._products, max(2 * len(self._products), last + 1, self._expected))
        edges = np.flatnonzero(np.diff(row_block)) + 1
        for own, part in zip(np.split(row_block, edges), np.split(columns, edges, axis=1), strict=True):
            if len(own):
                exact = part.astype(np.float64, copy=False)
                self._products[own[0]] += exact @ exact.T

    def stack(self, order: IndexArray) -> Stack:
        """Return all rows as a stack, with the blocks of rows in this order."""
        if self._products is not None:
            return ProductStack(_resize(self._products, len(order)))
        columns, row_block = self._pop_pending(order)
        return RowStack(columns.T, row_block, len(order))

    def counts(self, n_blocks: int) -> FloatArray:
        """Return the number of rows (s,) of each block."""
        return np.pad(self._counts, (0, n_blocks - len(self._counts)))

    def _pop_pending(self, order: IndexArray) -> tuple[FloatArray, IndexArray]:
        """Return the pending rows, column by column, and their blocks, in this order, and forget them."""
        columns, row_block = self._columns[:, : self.n_pending], np.zeros(0, dtype=np.intp)
        if self._row_block:
            row_block = np.concatenate(self._row_block)
        self._columns, self._row_block, self.n_pending = np.empty((len(columns), 0), dtype=columns.dtype), [], 0
        # A periodic motion comes back to earlier blocks, so that rows do not come in the order of their blocks.
        rank = np.argsort(order)[row_block]
        if (np.diff(rank) < 0).any():
            rows = np.argsort(rank, kind="stable")
            columns, row_block = columns.take(rows, axis=1), row_block[rows]
        return columns, row_block


def _resize(stack: FloatArray, length: int) -> FloatArray:
    """Return the first entries (length, ...) of a stack, or the stack with zeros behind it."""
    if len(stack) >= length:
        return stack[:length]
    longer = np.zeros((length, *stack.shape[1:]))
    longer[: len(stack)] = stack
    return longer


_FINER = 0.25
"""Blocks are so much shorter than those that an identification keeps: the more there are, the surer is what gains in
most of them, as long as they are long against the filters' memory."""

_MOST = 160
"""Blocks in all: more make the test no sharper, and each holds products of all columns with each other."""

_KINDS = 3
"""Of rows: moving, turning, partial."""

_LONG = 2.0
"""Times the width that the filters smear to either side: what is in one block is then so little in the next that the
test keeps its level (`benchmarks/decision_level.py`)."""


@dataclass(frozen=True, eq=False)
class ConditionalRows:
    """Rows that count only for the columns that they can show.

    Parameters
    ----------
    stacks : tuple of Stack
        The rows or their products, one stack a joint.
    counts : (s, n)
        Number of rows by block and joint.
    shown : (columns, n)
        For which columns they are equations of which joint.
    """

    stacks: tuple[Stack, ...]
    counts: FloatArray
    shown: BoolArray


@dataclass(frozen=True, eq=False)
class PhasedProducts:
    """What all scores are computed from: inner products by the phase of the joint's motion.

    Parameters
    ----------
    moving : Products
        Rows where the joint of the equation moves.
    turning : ConditionalRows
        Rows where it reverses without sticking. They count for friction that remembers its path, and for friction of
        low speeds where the joint never sticks.
    partial : ConditionalRows
        Rows of the motion beside a halt, which count for friction that acts where a joint starts.
    """

    moving: Products
    turning: ConditionalRows
    partial: ConditionalRows

    def select_for_model(self, columns: Sequence[int] | IndexArray) -> Products:
        """Return the rows that are equations for a model with these columns."""
        return self._combine_rows(self.select_joints(columns))

    def select_for_candidates(self, columns: Sequence[int] | IndexArray, kinds: BoolArray) -> Products:
        """Return the same with the rows of some kinds on all joints, for candidates on any joint.

        Parameters
        ----------
        columns : sequence of int
            Columns of the model.
        kinds : (2,)
            Whether rows at reversals, and rows beside halts, count on all joints.
        """
        return self._combine_rows(self.select_joints(columns) | kinds[:, None])

    def count_rows(self, columns: Sequence[int] | IndexArray) -> FloatArray:
        """Return the number of rows (s, n) that are equations for a model with these columns."""
        turns, starts = self.select_joints(columns)
        return np.asarray(self.moving.counts + turns * self.turning.counts + starts * self.partial.counts)

    def select_joints(self, columns: Sequence[int] | IndexArray) -> BoolArray:
        """Return (2, n): joints whose rows at reversals, and beside halts, count for a model with these columns."""
        own = np.asarray(columns, dtype=np.intp)
        return np.array([rows.shown[own].any(axis=0) for rows in (self.turning, self.partial)])

    def find_row_kinds(self, columns: Sequence[int] | IndexArray) -> tuple[bool, bool]:
        """Return whether rows at reversals, and beside halts, of any joint count for a model with these columns."""
        turns, starts = self.select_joints(columns)
        return bool(turns.any()), bool(starts.any())

    @cached_property
    def identity(self) -> object:
        """What is equal to that of these products alone, also once they are gone."""
        return object()

    @cached_property
    def _combinations(self) -> dict[bytes, Products]:
        """Rows that were combined before: a search asks for the same few over and over."""
        return {}

    def _combine_rows(self, used: BoolArray) -> Products:
        """Combine the rows in which each joint moves with those of `used` (2, n): at reversals, and beside halts."""
        key = used.tobytes()
        if key not in self._combinations:
            self._combinations[key] = self._build_combination(used)
        return self._combinations[key]

    def _build_combination(self, used: BoolArray) -> Products:
        more = [
            [
                rows
                for rows, use in zip((self.turning, self.partial), own, strict=True)
                if use and rows.counts[:, j].any()
            ]
            for j, own in enumerate(used.T)
        ]
        # Most models have no friction that other rows would show: the common case makes no new stacks.
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
        return Products(tuple(stacks), self.moving.position, counts, self.moving.run, self.moving.known)


def gather_products(
    observation: Observation,
    signals: Signals,
    inputs: RegressorInputs,
    n_base: int,
    progress: Progress = ignore_progress,
    samples_of: Callable[[Recording], Iterable[FilteredSamples]] | None = None,
) -> PhasedProducts:
    """Return inner products of all columns and Y, one block of time and joint at a time; W is never stored.

    Parameters
    ----------
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    n_base : int
        Number of columns of the model itself: their friction decides whose rows depend on the phase.
    samples_of : callable, optional
        Gives the filtered samples of a recording, where they are at hand.
    observation : Observation
        Columns of the model, and behind them those of the candidates.
    signals : Signals
        Signals that the columns are expressions of.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    PhasedProducts
        The products, by the phase of the joint's motion.
    """
    n = observation.robot.n
    layout = [observation.joint_entries(joint) for joint in range(n)]
    frictional = find_joints_with_friction(observation, n_base)
    # Blocks have to be long against this width: the filters carry what is in one block into its neighbours.
    width = compute_smear_width(inputs.preprocessing, inputs.recordings[0].sampling_rate)
    total = sum(compute_used_duration(recording) for recording in inputs.recordings)
    usual = max(_FINER * choose_block_length(inputs.recordings), total / _MOST)
    repeats = [find_periods(recording) for recording in inputs.recordings]
    # Upper bound of the blocks of periodic motion, for the memory that is set aside.
    n_periodic = sum(1 + MANY * len(periods) for each in repeats for periods in each)
    blocks = BlockNumbering(usual, _LONG * width)
    collected = RowAccumulator([len(columns) for _, columns in layout], _KINDS, int(total / usual) + n_periodic)
    done, free = 0.0, np.ones(n, dtype=bool)
    for recording, periods in zip(inputs.recordings, repeats, strict=True):
        phases = RowPhases.from_recording(observation, recording, inputs.preprocessing, n_base).with_friction_of(
            frictional
        )
        # A joint has to be free of sticking in every recording: rows of all of them are added up.
        free &= phases.free
        samples_of_recording = (
            stream_behind_kept_rows(observation, inputs, recording, phases)
            if samples_of is None
            else samples_of(recording)
        )
        segment = -1
        for samples in samples_of_recording:
            if samples.segment != segment:
                segment = samples.segment
                blocks.begin_run(recording.name_segment(segment), periods[segment])
            phase = phases.phases_at(segment, samples.t)
            partial_rows = phases.find_partial_rows(segment, samples.t, phase, samples.held)
            collected.push(
                blocks.number_times(samples.t),
                samples.stack_columns(layout),
                (phase == Phase.MOVING, phase == Phase.REVERSING, partial_rows),
            )
            progress(min(1.0, (done + samples.t[-1] - recording.segments[0].start_time) / total), recording.name)
        done += compute_used_duration(recording)
    starts = shows_at_starts(observation)
    # Where a joint never sticks, what acts at low speeds shows at its reversals as well.
    turns = remembers_path(observation, signals) | (starts & free)
    run = blocks.list_runs()
    (stacks, counts), turning, partial = collected.finish(order_by_folds(number_folds(run, KINDS)))
    position = tuple(_locate_columns(columns, observation.n_columns) for _, columns in layout)
    moving = Products(tuple((stack,) for stack in stacks), position, counts, run, inputs.known)
    return PhasedProducts(moving, ConditionalRows(*turning, turns), ConditionalRows(*partial, starts))


def _locate_columns(columns: IndexArray, count: int) -> IndexArray:
    """Return where each of all columns stands among those of a joint (count,), -1 where the joint lacks it."""
    where = np.full(count, -1, dtype=np.intp)
    where[columns] = np.arange(len(columns))
    return where
