"""`Reduction`: W and Y as one triangular factor an equation and block of time; its accumulator and joining.

The QR factor R of [W | Y] keeps every inner product of the columns without squaring their condition number, so
solving, weighting an equation, leaving a block out and choosing fewer columns are all small algebra on R.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.estimation.qr_decomposition import (
    WhitenedColumns,
    add_rows_to_factors,
    compute_r_factor,
    concatenate_stacks,
    join_factors,
    stack_blocks,
    whiten_columns,
)
from dynident.estimation.row_groups import BlockRows, RowGroup, SeparateRows, WeightedRows, join_separate_rows
from dynident.parallel import Deferring, defer

_FORGOTTEN = 1e-3
"""Weight below which a block of time counts as forgotten."""

RowGroupName = Literal["plain", "weighted", "counted"]
"""Groups of the rows that take part in a fit."""


@dataclass(frozen=True, eq=False)
class EquationFactors(Deferring):
    """The rows of one equation, block by block.

    Parameters
    ----------
    columns : (p,)
        Numbers of the parameters that the equation contains.
    factors : (s, m, p + 1)
        Triangular factor of [W | Y] of every block of time, Y last, in the rows m <= p + 1 that the fullest block
        needs; deferred where rows have a weight of their own.
    counts : (s,)
        Number of rows that each factor stands for.
    separate_rows : SeparateRows, optional
        Rows of the equation that are not fitted to, or whose residual is counted by itself.
    weighted_rows : WeightedRows, optional
        Rows with a weight of their own, which are in the factors with this weight.
    """

    columns: IndexArray
    factors: FloatArray
    counts: IndexArray
    separate_rows: SeparateRows | None = None
    weighted_rows: WeightedRows | None = None

    def __repr__(self) -> str:
        rows = int(self.counts.sum())
        return f"EquationFactors({len(self.columns)} columns, {rows} rows in {len(self.counts)} blocks)"

    @cached_property
    def whole_factor(self) -> FloatArray:
        """Factor (p + 1, p + 1) of all blocks together."""
        return join_factors(self.factors) if self.weighted_rows is None else self.weighted_rows.whole_factor

    @cached_property
    def whitened_columns(self) -> WhitenedColumns | None:
        """Columns without Y, whitened over all blocks; None where the equation excites none of them."""
        return whiten_columns(self.factors[:, :, :-1], self.whole_factor[:, :-1])

    @property
    def own_noise(self) -> float:
        """Noise that is left when the equation is fitted by itself: a first guess, before any parameter is known."""
        freedom = max(float(self.counts.sum()) - len(self.columns), 1.0)
        return abs(float(self.whole_factor[-1, -1])) / float(np.sqrt(freedom))

    def factor_without_blocks(self, blocks: Sequence[int]) -> FloatArray:
        """Return the factor (p + 1, p + 1) of all blocks but these."""
        keep = np.ones(len(self.factors), dtype=bool)
        keep[list(blocks)] = False
        return join_factors(self.factors[keep])

    def select_columns(self, columns: IndexArray) -> EquationFactors:
        """Return the same rows with only these parameters; parameters that the equation does not contain are ignored.

        The positions in `columns` (k,) become the new parameter numbers.
        """
        # Columns are numbered over all parameters; an equation holds only those that act on it, so that its factor
        # stays small.
        where = {int(column): position for position, column in enumerate(self.columns)}
        chosen = [(new, where[int(old)]) for new, old in enumerate(columns) if int(old) in where]
        selected = [position for _, position in chosen] + [len(self.columns)]
        separate_rows = (
            None if self.separate_rows is None else self.separate_rows.select([position for _, position in chosen])
        )
        numbers = np.array([new for new, _ in chosen], dtype=np.intp)
        if self.weighted_rows is not None:
            return self.from_groups(numbers, self.weighted_rows.select(selected), self.counts, separate_rows)
        # Columns that are taken out of a triangular factor leave it no longer triangular: one more QR decomposition, of
        # a few rows, restores it. No data is read again.
        return EquationFactors(numbers, compute_r_factor(self.factors[:, :, selected]), self.counts, separate_rows)

    def weight_group(self, weight: float) -> EquationFactors:
        """Return the same rows, with squared residuals of the weighted rows multiplied by `weight`."""
        if self.weighted_rows is None or self.weighted_rows.weight == weight:
            return self
        return self.from_groups(self.columns, self.weighted_rows.change_weight(weight), self.counts, self.separate_rows)

    @property
    def group_rows(self) -> RowGroup | WeightedRows | None:
        """The rows that have or had a weight of their own, each counting alike; None where they are not known."""
        fixed = None if self.separate_rows is None else self.separate_rows.fixed
        return self.weighted_rows if fixed is None else fixed

    @property
    def with_fixed_weights(self) -> EquationFactors:
        """The same rows, where none can be weighted any more, only counted by themselves."""
        if self.weighted_rows is None:
            return self
        separate_rows = self.separate_rows
        if separate_rows is not None and separate_rows.fixed is None:
            # The weighted rows stay known as a group over all blocks, so that errors can still be counted without them.
            separate_rows = replace(separate_rows, fixed=self.weighted_rows.row_group)
        return EquationFactors(self.columns, self.factors, self.counts, separate_rows)

    @classmethod
    def from_groups(
        cls, columns: IndexArray, weighted_rows: WeightedRows, counts: IndexArray, separate_rows: SeparateRows | None
    ) -> EquationFactors:
        """Build an equation from its weighted rows and the others; the factors of its blocks when they are needed.

        Parameters
        ----------
        columns : (p,)
            Numbers of the parameters that the equation contains.
        weighted_rows : WeightedRows
            Rows with a weight of their own, and the others.
        counts : (s,)
            Number of all rows of every block.
        separate_rows : SeparateRows or None
            Rows that are counted by themselves.
        """
        return cls(columns, defer(lambda: weighted_rows.weighted_factors), counts, separate_rows, weighted_rows)

    def combine_columns(self, weights: FloatArray) -> EquationFactors:
        """Return the same rows with combined columns; `weights` (c, c') lead from all columns to the new ones."""
        # An equation keeps only the new columns to which one of its own contributes.
        own = weights[self.columns]
        chosen = np.flatnonzero((own != 0).any(axis=0))
        k = len(self.columns)
        whole = np.zeros((k + 1, len(chosen) + 1))
        # The last column is Y, which every combination leaves as it is.
        whole[:k, :-1], whole[k, -1] = own[:, chosen], 1.0
        separate_rows = None if self.separate_rows is None else self.separate_rows.combine_columns(whole)
        if self.weighted_rows is not None:
            weighted_rows = self.weighted_rows.combine_columns(whole)
            return self.from_groups(chosen.astype(np.intp), weighted_rows, self.counts, separate_rows)
        factors = compute_r_factor(self.factors @ whole)
        return EquationFactors(chosen.astype(np.intp), factors, self.counts, separate_rows)

    def mix_columns(self, change: FloatArray, columns: IndexArray) -> EquationFactors:
        """Return the rows of [W | Y] change, with Y and W mixed.

        Interval rows are dropped: an interval for Y is none for a combination of Y and columns.

        Parameters
        ----------
        change : (p + 1, p' + 1)
        columns : (p',)
            Numbers of the new columns.
        """
        factors = compute_r_factor(self.factors @ change)
        return EquationFactors(np.asarray(columns, dtype=np.intp), factors, self.counts)

    def sum_group_squares(self, group: RowGroupName, values: FloatArray) -> FloatArray:
        """Return the sum of squared residuals of parameters χ (c,) in every block (s,), on one group of fitted rows.

        Weighted and counted rows that are not known by blocks of time count as plain.
        """
        own, whole = values[self.columns], self.sum_squares(values)
        weighted, counted = np.zeros_like(whole), np.zeros_like(whole)
        weight = 1.0
        if self.separate_rows is not None and self.weighted_rows is not None:
            weighted, weight = self.weighted_rows.sum_block_squares(own), self.weighted_rows.weight
        if self.separate_rows is not None and len(self.separate_rows.counted.counts) == len(whole):
            counted = self.separate_rows.counted.sum_block_squares(own)
        if group == "plain":
            # Differences of sums of squares may fall below zero by rounding.
            return np.maximum(whole - weight * weighted - counted, 0.0)
        return weighted if group == "weighted" else counted

    def sum_squares(self, values: FloatArray) -> FloatArray:
        """Return the sum of squared residuals of parameters χ (c,) in every block (s,)."""
        k = len(self.columns)
        # An orthogonal transformation keeps lengths: the residual of R has the same sum of squares as that of the rows.
        rests = self.factors[:, :, k] - self.factors[:, :, :k] @ values[self.columns]
        return np.asarray((rests * rests).sum(axis=1))


@dataclass(frozen=True, eq=False)
class Reduction:
    """All equations of a data set, reduced to triangular factors.

    Parameters
    ----------
    n_columns : int
        Number of parameters c.
    equations : tuple of EquationFactors
        One per equation, all of them by the same blocks of time.
    spans : (s, 2)
        First and last time of every block, in s.
    """

    n_columns: int
    equations: tuple[EquationFactors, ...]
    spans: FloatArray

    def __repr__(self) -> str:
        return (
            f"Reduction({len(self.equations)} equations of {self.n_columns} columns, {self.n_rows} rows in "
            f"{self.n_blocks} blocks)"
        )

    @property
    def n_blocks(self) -> int:
        """Number of blocks of time."""
        return len(self.spans)

    @cached_property
    def n_rows(self) -> int:
        """Number of rows r over all equations."""
        return int(sum(equation.counts.sum() for equation in self.equations))

    @cached_property
    def row_counts(self) -> FloatArray:
        """Number of rows of every equation (n,)."""
        counts = np.array([float(equation.counts.sum()) for equation in self.equations])
        counts.setflags(write=False)
        return counts

    @cached_property
    def measured_sizes(self) -> FloatArray:
        """Norm of Y of every equation (n,), its rows as they are weighted."""
        return np.array([float(np.linalg.norm(equation.whole_factor[:, -1])) for equation in self.equations])

    def select_columns(self, columns: Sequence[int] | IndexArray) -> Reduction:
        """Return the same data with only these columns, in this order."""
        chosen = np.asarray(columns, dtype=np.intp)
        return Reduction(len(chosen), tuple(e.select_columns(chosen) for e in self.equations), self.spans)

    def combine_columns(self, weights: FloatArray) -> Reduction:
        """Return the same data with combined columns: W' = W weights, weights (c, c')."""
        return Reduction(weights.shape[1], tuple(e.combine_columns(weights) for e in self.equations), self.spans)

    def move_columns(self, values: FloatArray, remaining: BoolArray) -> Reduction:
        """Return the same data with Y - W values for Y, and only the columns that remain, both (c,)."""
        numbers = np.cumsum(remaining) - 1
        equations = []
        for equation in self.equations:
            own = np.flatnonzero(remaining[equation.columns])
            k = len(equation.columns)
            change = np.zeros((k + 1, len(own) + 1))
            change[own, np.arange(len(own))], change[k, -1] = 1.0, 1.0
            change[:k, -1] = -values[equation.columns]
            equations.append(equation.mix_columns(change, numbers[equation.columns[own]]))
        return Reduction(int(remaining.sum()), tuple(equations), self.spans)

    def weight_groups(self, weights: FloatArray) -> Reduction:
        """Return the same data, with squared residuals of weighted rows multiplied by `weights` (n,), by equation."""
        pairs = zip(self.equations, weights, strict=True)
        return replace(self, equations=tuple(equation.weight_group(float(weight)) for equation, weight in pairs))

    @property
    def equally_weighted(self) -> Reduction:
        """The same data, every row counting alike."""
        return self.weight_groups(np.ones(len(self.equations)))

    def merge_block_pairs(self) -> Reduction:
        """Return the same plain rows in half as many blocks of time: the first two are one, the next two, and so on.

        Groups of rows that are counted by themselves are not kept.
        """
        equations, odd = [], self.n_blocks % 2
        for equation in self.equations:
            s, m, k = equation.factors.shape
            # A block without rows fills the last pair up. An equation without rows has no blocks.
            filling = s % 2
            factors = np.concatenate([equation.factors, np.zeros((filling, m, k))])
            factors = factors.reshape((s + filling) // 2, 2 * m, k)
            counts = np.append(equation.counts, [0] * filling).reshape(-1, 2).sum(axis=1)
            equations.append(EquationFactors(equation.columns, compute_r_factor(factors), counts))
        ends = np.append(self.spans[1::2, 1], self.spans[-1:, 1] if odd else [])
        spans = np.stack([self.spans[::2, 0], ends], axis=1)
        return Reduction(self.n_columns, tuple(equations), spans)

    def forget_exponentially(self, memory: float) -> Reduction:
        """Return the plain rows with less weight the older they are: exp(-age / memory) of a squared residual.

        Parameters
        ----------
        memory : float
            Age, before the end of the last block, at which a weight of 1/e is left, s.

        Returns
        -------
        Reduction
            Every block with one weight; blocks that count for less than a thousandth are left out.
        """
        weights = np.exp((self.spans[:, 1] - self.spans[-1, 1]) / memory)
        (recent,) = np.nonzero(weights >= _FORGOTTEN)
        equations = tuple(
            EquationFactors(
                e.columns,
                e.factors[recent] * np.sqrt(weights[recent])[:, None, None],
                # As many rows as the weighted ones are worth.
                np.rint(e.counts[recent] * weights[recent]).astype(np.intp),
            )
            for e in self.equations
        )
        return Reduction(self.n_columns, equations, self.spans[recent])

    def select_blocks(self, indices: Sequence[int]) -> Reduction:
        """Return only the blocks of time with these indices."""
        selected = list(indices)
        equations = tuple(EquationFactors(e.columns, e.factors[selected], e.counts[selected]) for e in self.equations)
        return Reduction(self.n_columns, equations, self.spans[selected])


def concatenate_reductions(parts: Sequence[Reduction]) -> Reduction:
    """Put data sets with the same columns behind one another.

    Parameters
    ----------
    parts : sequence of Reduction
        Data sets with the same equations and columns.

    Returns
    -------
    Reduction
        The blocks of the first data set, then those of the second, and so on.
    """
    first = parts[0]
    if len(parts) == 1:
        return first
    equations = tuple(
        _concatenate_equations([part.equations[j] for part in parts]) for j in range(len(first.equations))
    )
    return Reduction(first.n_columns, equations, np.concatenate([part.spans for part in parts]))


def _concatenate_equations(parts: Sequence[EquationFactors]) -> EquationFactors:
    """Concatenate one equation of several data sets; rows can be weighted only where all data sets know them."""
    weighted_rows = [part.weighted_rows for part in parts if part.weighted_rows is not None]
    # A part that does not know which rows have a weight of their own has them among its other rows, where no weight can
    # reach them. Then no part may be weighted, so that rows of one kind count alike everywhere.
    if len(weighted_rows) < len(parts):
        parts = [part.with_fixed_weights for part in parts]
    return EquationFactors(
        parts[0].columns,
        concatenate_stacks([part.factors for part in parts]),
        np.concatenate([part.counts for part in parts]),
        join_separate_rows([part.separate_rows for part in parts]),
        WeightedRows.join(weighted_rows) if len(weighted_rows) == len(parts) else None,
    )


def merge_row_groups(split: Reduction) -> Reduction:
    """Merge 3 n equations into n with groups of rows: those that can be weighted, and those that are counted.

    Parameters
    ----------
    split : Reduction
        The n equations of plain rows, the n of the same equations' rows with a weight of their own, and the n of their
        rows that are counted by themselves.

    Returns
    -------
    Reduction
        The n equations, each with all its rows.
    """
    n = len(split.equations) // 3
    equations = []
    for j in range(n):
        plain, own, counted = split.equations[j::n]
        group = BlockRows.from_factors(own.factors, own.counts)
        counted_rows = BlockRows.from_factors(counted.factors, counted.counts)
        others = add_rows_to_factors(plain.factors, counted_rows.rows)
        separate_rows = None if plain.separate_rows is None else replace(plain.separate_rows, counted=counted_rows)
        weighted_rows = WeightedRows(group.rows, group.counts, others)
        counts = plain.counts + own.counts + counted.counts
        equations.append(EquationFactors.from_groups(plain.columns, weighted_rows, counts, separate_rows))
    return replace(split, equations=tuple(equations))


class FactorAccumulator:
    """Folds rows into triangular factors as they come, so that no data set has to fit into memory.

    Parameters
    ----------
    columns : one (p,) array per equation
        The parameters that each equation contains.
    n_columns : int
        Number of all parameters c.
    block_length : float
        Length of a block of time, s.
    """

    # Rows collected before they are folded: QR of a tall block costs less than of many short ones.
    _PENDING = 2048

    def __init__(self, columns: Sequence[IndexArray], n_columns: int, block_length: float) -> None:
        self._columns = [np.asarray(item, dtype=np.intp) for item in columns]
        self._n_columns = n_columns
        self._block_length = block_length
        self._factors: list[list[FloatArray]] = [[] for _ in self._columns]
        self._counts: list[IndexArray] = []
        self._spans: list[tuple[float, float]] = []
        self._pending: list[list[FloatArray]] = [[] for _ in self._columns]
        self._pending_rows = 0
        self._empty = [np.zeros((0, len(item) + 1)) for item in self._columns]
        self._open = list(self._empty)
        self._count = np.zeros(len(self._columns), dtype=np.intp)
        self._is_open = False
        self._from = 0.0
        self._to = 0.0

    def push(self, t: FloatArray, rows: Sequence[FloatArray], used: BoolArray | None = None) -> None:
        """Add the next samples.

        Parameters
        ----------
        t : (m,)
            Times, s.
        rows : one (m, p + 1) array per equation
            Rows of [W | Y].
        used : (m, equations), optional
            Which rows of which equation count; all of them where it is left out.
        """
        first = 0
        while first < len(t):
            if not self._is_open:
                self._from, self._is_open = float(t[first]), True
            # Blocks are cut by time, not by number of rows, so that they last alike in recordings of any sampling rate.
            last = first + int(np.searchsorted(t[first:], self._from + self._block_length))
            if last > first:
                is_used = None if used is None else used[first:last]
                counts = np.full(len(rows), last - first) if is_used is None else np.count_nonzero(is_used, axis=0)
                for k in np.flatnonzero(counts).tolist():
                    part = rows[k][first:last]
                    self._pending[k].append(part if is_used is None else part[is_used[:, k]])
                self._count += counts
                self._pending_rows += last - first
                self._to = float(t[last - 1])
                if self._pending_rows >= self._PENDING:
                    self._fold()
            if last < len(t):
                self.end_block()
            first = last

    def end_block(self) -> None:
        """Close the current block of time: a recording or a segment ends here."""
        if not self._is_open:
            return
        # Pending rows belong to the block that closes: they have to be folded before the next one begins.
        self._fold()
        for factors, factor in zip(self._factors, self._open, strict=True):
            factors.append(factor)
        self._counts.append(self._count.copy())
        self._spans.append((self._from, self._to))
        self._open = list(self._empty)
        self._count[:] = 0
        self._is_open = False

    def _fold(self) -> None:
        """Fold the pending rows into the open block's factors."""
        if self._pending_rows == 0:
            return
        for k, pending in enumerate(self._pending):
            if pending:
                # R of [R_before; new rows] is the R of all rows together, which never have to be in memory at once.
                self._open[k] = compute_r_factor(np.concatenate([self._open[k], *pending]))
        self._pending = [[] for _ in self._columns]
        self._pending_rows = 0

    def finish(self) -> Reduction:
        """Close the last block and return all factors."""
        self.end_block()
        counts = np.array(self._counts, dtype=np.intp).reshape(-1, len(self._columns))
        equations = tuple(
            EquationFactors(columns, stack_blocks(factors, len(columns) + 1), counts[:, k])
            for k, (columns, factors) in enumerate(zip(self._columns, self._factors, strict=True))
        )
        return Reduction(self._n_columns, equations, np.array(self._spans).reshape(-1, 2))
