"""Inner products of columns and Y by block of time, and the folds of these blocks over which candidates are scored.

Holds the number of folds (5, and 10 parts).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Protocol, TypeVar

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.estimation import PriorInformation

KINDS = ("interleaved", "contiguous")
"""Kinds of folds in which candidates are scored."""

# Numbers of folds: a model is fitted once a fold, and loses that share of the data.
N_FOLDS = 5
N_PARTS = 10
MOST_PRODUCTS = 2**26
"""Numbers, 0.5 GB: of a machine with more of them, rows are kept as long as they are fewer numbers, and in four bytes
each: these round a value by 6e-8 of itself, and sensors are a thousand times as noisy."""
# Of rows: where a joint moves, at reversals, and beside halts.
_ROW_KINDS = 3
# Numbers of pairs of columns that are multiplied at once.
_MOST_VALUES = 2**16


T = TypeVar("T")


class Stack(Protocol):
    """Rows of one kind of a joint's equation, by block, as far as their inner products show them."""

    def sum_products(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (k, l) over all blocks, at some places."""

    @property
    def torque_squared(self) -> float:
        """Sum of the squared torque."""

    def take_products(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (s, *shape) at these places, whose shapes are broadcast."""


def split_runs(numbers: IndexArray) -> Iterator[tuple[int, slice]]:
    """Yield the runs of equal numbers that follow one another: the number, and where it stands."""
    starts = np.flatnonzero(numbers[1:] != numbers[:-1]) + 1
    for first, last in pairwise([0, *starts.tolist(), len(numbers)]):
        if last > first:
            yield int(numbers[first]), slice(first, last)


class RowRuns:
    """Where the rows of each block begin, which follow one another.

    Parameters
    ----------
    row_block : (m,)
        Number of the block of each row.
    n_blocks : int
        Number of blocks.
    """

    def __init__(self, row_block: IndexArray, n_blocks: int) -> None:
        self.n_blocks = n_blocks
        self._firsts = np.flatnonzero(np.diff(row_block, prepend=-1))
        self._edges, self._blocks = np.append(self._firsts, len(row_block)), row_block[self._firsts]
        self._spans: dict[bytes, list[tuple[int, slice]]] = {}

    def sum_by_block(self, values: FloatArray) -> FloatArray:
        """Sum values (..., m) over the rows of every block (..., s)."""
        sums = np.zeros((*values.shape[:-1], self.n_blocks))
        if len(self._firsts):
            sums[..., self._blocks] = np.add.reduceat(values, self._firsts, axis=-1)
        return sums

    def split_rows(self, numbers: IndexArray) -> list[tuple[int, slice]]:
        """List rows that follow one another and whose blocks have the same of some numbers (s,), and this number."""
        key = numbers.tobytes()
        # Every score asks for the same few.
        if key not in self._spans:
            edges, runs = self._edges, split_runs(numbers[self._blocks])
            self._spans[key] = [(number, slice(int(edges[own.start]), int(edges[own.stop]))) for number, own in runs]
        return self._spans[key]

    def split_pieces(self, most: int) -> list[tuple[slice, RowRuns]]:
        """List rows of so many blocks that they are at most `most`, or of one block, and their own runs."""
        edges, pieces, first = self._edges, [], 0
        if edges[-1] <= most:
            return [(slice(int(edges[-1])), self)]
        while first < len(self._blocks):
            last = max(first + 1, int(np.searchsorted(edges, edges[first] + most, side="right")) - 1)
            counts = np.diff(edges[first : last + 1])
            own = RowRuns(np.repeat(self._blocks[first:last], counts), self.n_blocks)
            pieces.append((slice(int(edges[first]), int(edges[last])), own))
            first = last
        return pieces


@dataclass(frozen=True, eq=False)
class BlockSets:
    """Sets of blocks over which products are summed: all blocks, and those of each fold.

    Parameters
    ----------
    kinds : tuple of str
        Kinds of folds.
    folds : (kinds, s)
        Number of the fold that each block is in, by kind.
    """

    kinds: tuple[str, ...]
    folds: IndexArray

    @cached_property
    def order(self) -> IndexArray:
        """Numbers of the blocks (s,), such that those in the same fold of every kind follow one another."""
        return order_by_folds(self.folds)

    @cached_property
    def _is_first(self) -> BoolArray:
        """Which blocks (s,), in that order, begin a cell: blocks that are in the same fold of every kind."""
        return np.append(True, (np.diff(self.folds[:, self.order], axis=1) != 0).any(axis=0))

    @cached_property
    def cells(self) -> IndexArray:
        """Number of the cell that each block is in (s,)."""
        cells = np.empty(len(self.order), dtype=np.intp)
        cells[self.order] = np.cumsum(self._is_first) - 1
        return cells

    @cached_property
    def members(self) -> FloatArray:
        """(sets, cells): one for the cells of each set, zero for others."""
        each = self.folds[:, self.order[self._is_first]]
        left_out = [own == number for own in each for number in range(own.max() + 1)]
        return np.array([np.ones(each.shape[1], dtype=bool), *left_out], dtype=np.float64)

    def list_folds(self, kind: str) -> range:
        """Return the numbers of the sets that are the folds of a kind."""
        counts, place = self.folds.max(axis=1) + 1, self.kinds.index(kind)
        first = 1 + int(counts[:place].sum())
        return range(first, first + int(counts[place]))


@dataclass(frozen=True, eq=False)
class _KeptRows:
    """Products over sets of blocks of some columns with all p + 1, and where each column stands among these.

    Parameters
    ----------
    sums : (sets, r, p + 1)
        The products.
    place : (p + 1,)
        Number of each column among the r; -1 for others.
    """

    sums: FloatArray
    place: IndexArray

    def append(self, columns: IndexArray, sums: FloatArray) -> _KeptRows:
        """Return them with the products (sets, k, p + 1) of more columns (k,)."""
        place, r = self.place.copy(), self.sums.shape[1]
        place[columns] = r + np.arange(len(columns))
        return _KeptRows(np.concatenate([self.sums, sums], axis=1) if r else sums, place)

    def take(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (sets, *shape) at these places, whose shapes are broadcast."""
        # One flat index instead of three: four times as fast.
        places = self.place[rows] * self.sums.shape[2] + columns
        return np.asarray(self.sums.reshape(len(self.sums), -1).take(places, axis=1))


class RowStack:
    """The rows [W | Y] themselves.

    Where a block has fewer rows than the model columns, these are fewer numbers than their products, and quicker to
    read a score from. They are stored as `columns` (p + 1, m), of which a score takes some; where there are very many
    in numbers of four bytes, which are summed in eight.

    Parameters
    ----------
    values : (m, p + 1)
        Rows.
    row_block : (m,)
        Number of the block of each row; the rows of a block follow one another.
    n_blocks : int
        Number of blocks.
    """

    def __init__(self, values: FloatArray, row_block: IndexArray, n_blocks: int) -> None:
        self.columns, self._runs = np.ascontiguousarray(values.T), RowRuns(row_block, n_blocks)
        self._kept_rows = _KeptRows(np.zeros((0, 0, 0)), np.full(len(self.columns), -1, dtype=np.intp))
        self._kept_pairs = np.zeros(0, dtype=np.intp), np.zeros((0, 0))

    def add_sums(
        self, sets: BlockSets, rows: IndexArray | slice, columns: IndexArray | slice, sums: FloatArray
    ) -> None:
        """Add the products at some places to those (sets, k, l) over sets of blocks."""
        for cell, span in self._runs.split_rows(sets.cells):
            first, second = (self.columns[places, span].astype(np.float64, copy=False) for places in (rows, columns))
            own = first @ second.T
            for number in np.flatnonzero(sets.members[:, cell]):
                sums[number] += own

    def take_sums(self, sets: BlockSets, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (sets, k, l) of some columns, such as a model has, with others.

        Those with all columns are kept; candidates, of which there are many more, are never asked for with each other.
        """
        known = self._kept_rows
        missing = rows[known.place[rows] < 0]
        if len(missing):
            sums = np.zeros((len(sets.members), len(missing), len(self.columns)))
            self.add_sums(sets, missing, slice(None), sums)
            known = self._kept_rows = known.append(missing, sums)
        return known.take(rows[:, None], columns)

    def take_pair_sums(self, sets: BlockSets, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (sets, l) of pairs (l,) of columns; they are kept."""
        if (self._kept_rows.place[rows] >= 0).all():
            return self._kept_rows.take(rows, columns)
        keys, sums = self._kept_pairs
        # A product is the same in both orders.
        numbers = np.minimum(rows, columns) * len(self.columns) + np.maximum(rows, columns)
        places = np.searchsorted(keys, numbers)
        is_missing = np.append(keys, -1)[places] != numbers
        if is_missing.any():
            new = np.unique(numbers[is_missing])
            products = self.take_products(*np.divmod(new, len(self.columns)))
            own = np.tensordot(sets.members[:, sets.cells], products, 1)
            keys, order = np.unique(np.concatenate([keys, new]), return_index=True)
            sums = np.concatenate([sums.reshape(len(own), -1), own], axis=1)[:, order]
            self._kept_pairs, places = (keys, sums), np.searchsorted(keys, numbers)
        return sums.take(places, axis=1)

    def sum_products(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (k, l) over all blocks, at some places."""
        # Those of all columns would be more numbers than the rows where a robot has many joints.
        first, second = (self.columns[places].astype(np.float64, copy=False) for places in (rows, columns))
        return np.asarray(first @ second.T)

    @property
    def torque_squared(self) -> float:
        """Sum of the squared torque."""
        return float((self.columns[-1].astype(np.float64) ** 2).sum())

    def read_columns(self, needed: IndexArray, rows: slice) -> FloatArray:
        """Return some columns (c, m), by their places, of some rows."""
        return self.columns[needed, rows].astype(np.float64, copy=False)

    def split_pieces(self, most: int) -> list[tuple[slice, RowRuns]]:
        """List pieces of at most so many rows, and the runs of their blocks."""
        return self._runs.split_pieces(most)

    def take_products(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (s, *shape) at these places, whose shapes are broadcast."""
        first, second = np.broadcast_arrays(rows, columns)
        products, pairs = np.empty((first.size, self._runs.n_blocks)), np.stack([first.ravel(), second.ravel()])
        # A few pairs at a time: their rows stay in the cache, and take little memory however many pairs there are.
        together = max(1, _MOST_VALUES // max(1, self.columns.shape[1]))
        for k in range(0, first.size, together):
            left, right = (self.columns[own].astype(np.float64, copy=False) for own in pairs[:, k : k + together])
            products[k : k + together] = self._runs.sum_by_block(left * right)
        return products.T.reshape(self._runs.n_blocks, *first.shape)


class ProductStack:
    """Inner products of rows alone.

    They are never copied as a whole: there may be gigabytes of them.

    Parameters
    ----------
    values : (s, p + 1, p + 1)
        Products by block.
    """

    def __init__(self, values: FloatArray) -> None:
        self.values = values

    @cached_property
    def total(self) -> FloatArray:
        """Products (p + 1, p + 1) over all blocks."""
        return np.asarray(self.values.sum(axis=0))

    def sum_products(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (k, l) over all blocks, at some places."""
        return self.total[np.ix_(rows, columns)]

    @property
    def torque_squared(self) -> float:
        """Sum of the squared torque."""
        return float(self.values[:, -1, -1].sum())

    def take_products(self, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (s, *shape) at these places, whose shapes are broadcast."""
        wide = self.values.shape[1]
        places = rows * wide + columns
        # One flat index instead of three: four times as fast.
        selected = self.values.reshape(len(self.values), wide * wide).take(places.ravel(), axis=1)
        return np.asarray(selected.reshape(len(selected), *places.shape))


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of all columns and Y by block and joint.

    Parameters
    ----------
    stacks : tuple of tuple of Stack
        Rows or products of each joint, which add up.
    position : tuple of (columns,)
        Place of each column in the products of a joint, -1 where the joint lacks it; Y stands last.
    counts : (s, n)
        Number of rows by block and joint.
    run : (s,)
        Number of the run that each block is of.
    known : PriorInformation, optional
        What is known of the first columns' parameters beside the data.
    """

    stacks: tuple[tuple[Stack, ...], ...]
    position: tuple[IndexArray, ...]
    counts: FloatArray
    run: IndexArray
    known: PriorInformation | None = None

    @classmethod
    def from_grams(
        cls, grams: Iterable[FloatArray], position: Iterable[IndexArray], counts: FloatArray, run: IndexArray
    ) -> Products:
        """Build them from the products (s, p_j + 1, p_j + 1) of every joint."""
        return cls(tuple((ProductStack(gram),) for gram in grams), tuple(position), counts, run)

    @property
    def n_blocks(self) -> int:
        """Number of blocks of time."""
        return len(self.counts)

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.stacks)

    def sum_products(self, joint: int, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (k, l) of a joint over all blocks, of some of the model's places with others."""
        if self._keeps_all_sums(joint):
            # The first set is all blocks.
            return np.asarray(self._take_sums(joint, rows, columns)[0])
        return self._sum_stacks(joint, rows, columns)

    def sum_own_products(self, joint: int, columns: IndexArray) -> FloatArray:
        """Return the products (k, k) of a joint over all blocks, of the places of a candidate's columns."""
        if self._keeps_all_sums(joint):
            pairs = np.repeat(columns, len(columns)), np.tile(columns, len(columns))
            return np.asarray(self._take_pair_sums(joint, *pairs)[0].reshape(len(columns), -1))
        return self._sum_stacks(joint, columns, columns)

    def _sum_stacks(self, joint: int, rows: IndexArray, columns: IndexArray) -> FloatArray:
        first, *others = (stack.sum_products(rows, columns) for stack in self.stacks[joint])
        return sum(others, first)

    def _keeps_all_sums(self, joint: int) -> bool:
        return self._has_few_sums and len(self.list_row_stacks(joint)) == len(self.stacks[joint])

    def find_cached(self, key: Hashable, build: Callable[[], T]) -> T:
        """Return what was built from these products under this key, or build it."""
        if key not in self._cache:
            self._cache[key] = build()
        value: T = self._cache[key]
        return value

    @cached_property
    def _cache(self) -> dict[Hashable, Any]:
        return {}

    def take_products(self, joint: int, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (s, *shape) of a joint at these places, whose shapes are broadcast."""
        first, *others = (stack.take_products(rows, columns) for stack in self.stacks[joint])
        for other in others:
            first += other
        return first

    @cached_property
    def sets(self) -> BlockSets:
        """The folds in which candidates are scored."""
        return self.number_sets(KINDS)

    def sum_sets(self, joint: int, sets: BlockSets, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (sets, k, l) of a joint's rows over sets of blocks, at some of its places."""
        if self._keeps_sums(sets):
            return self._take_sums(joint, rows, columns)
        sums = np.zeros((len(sets.members), len(rows), len(columns)))
        for stack in self.list_row_stacks(joint):
            stack.add_sums(sets, rows, columns, sums)
        return sums

    def sum_pairs(self, joint: int, sets: BlockSets, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the products (sets, l) of pairs (l,) of a joint's columns over sets of blocks."""
        if self._keeps_sums(sets):
            return self._take_pair_sums(joint, rows, columns)
        return np.asarray(np.tensordot(sets.members[:, sets.cells], self.take_products(joint, rows, columns), 1))

    def list_row_stacks(self, joint: int) -> list[RowStack]:
        """List the rows of a joint, by kind; those that are folded to products are none."""
        return [stack for stack in self.stacks[joint] if isinstance(stack, RowStack)]

    def _keeps_sums(self, sets: BlockSets) -> bool:
        """Return whether sums of all columns are kept: every score of a search takes some of those of its own folds."""
        return sets is self.sets and self._has_few_sums

    @cached_property
    def _has_few_sums(self) -> bool:
        """Whether the sums would be few numbers even of all columns, and of all kinds of rows: where joints are few."""
        squares = sum((int((where >= 0).sum()) + 1) ** 2 for where in self.position)
        return _ROW_KINDS * len(self.sets.members) * squares <= MOST_PRODUCTS

    def _take_sums(self, joint: int, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the kept products (sets, k, l) of some of the model's places of a joint with others."""
        stacks = self.list_row_stacks(joint)
        # The last place may be called -1.
        rows, columns = (places % len(stacks[0].columns) for places in (rows, columns))
        first, *others = (stack.take_sums(self.sets, rows, columns) for stack in stacks)
        return np.asarray(sum(others, first))

    def _take_pair_sums(self, joint: int, rows: IndexArray, columns: IndexArray) -> FloatArray:
        """Return the kept products (sets, l) of pairs (l,) of places of a joint."""
        first, *others = (stack.take_pair_sums(self.sets, rows, columns) for stack in self.list_row_stacks(joint))
        return np.asarray(sum(others, first))

    def number_sets(self, kinds: Sequence[str]) -> BlockSets:
        """Return folds of some kinds as sets of blocks."""
        return BlockSets(tuple(kinds), number_folds(self.run, kinds))

    def torque_squared(self) -> FloatArray:
        """Return the sum (n,) of each joint's squared torque."""
        return np.array([sum(stack.torque_squared for stack in own) for own in self.stacks])


def split_folds(n_blocks: int, kind: str) -> list[IndexArray]:
    """Return the blocks that are left out together: every fifth (`interleaved`) or a fifth in a row (`contiguous`)."""
    order = np.arange(n_blocks)
    count = min(N_FOLDS, n_blocks)
    if kind == "interleaved":
        return [order[k::count] for k in range(count)]
    return [np.asarray(part, dtype=np.intp) for part in np.array_split(order, count)]


def split_data_folds(data: Products, kind: str) -> list[IndexArray]:
    """Return the folds of some data, ascending: whole `runs`, `parts` of each (a tenth in a row), or as `split_folds`.

    A fifth in a row is one of every run: a fast motion of all joints beside a long test of a single one would else be
    left out as a whole, and the model of most joints unknown without it. Runs too short for that count as one.
    """
    return _split_runs_into_folds(data.run, kind)


def _split_runs_into_folds(run: IndexArray, kind: str) -> list[IndexArray]:
    each = [np.flatnonzero(run == number) for number in np.unique(run)]
    if kind == "runs":
        return each
    if kind == "parts":
        return [part for own in each for part in _split_tenths(own)]
    if kind == "interleaved":
        return split_folds(len(run), kind)
    long = [own for own in each if len(own) >= N_FOLDS]
    short = [own for own in each if len(own) < N_FOLDS]
    together = [np.concatenate(short)] if short else []
    parts = zip(*(np.array_split(own, N_FOLDS) for own in long + together), strict=True)
    return [np.sort(fold) for fold in map(np.concatenate, parts) if len(fold)]


def number_folds(run: IndexArray, kinds: Sequence[str]) -> IndexArray:
    """Return the number (kinds, s) of the fold that each block is in, by kind."""
    numbers = np.zeros((len(kinds), len(run)), dtype=np.intp)
    for own, kind in zip(numbers, kinds, strict=True):
        for k, fold in enumerate(_split_runs_into_folds(run, kind)):
            own[fold] = k
    return numbers


def order_by_folds(folds: IndexArray) -> IndexArray:
    """Return the blocks (s,) such that those in the same fold of every kind (kinds, s) follow one another."""
    return np.lexsort(folds[::-1])


def _split_tenths(blocks: IndexArray) -> list[IndexArray]:
    return [part for part in np.array_split(blocks, min(N_PARTS, len(blocks))) if len(part)]
