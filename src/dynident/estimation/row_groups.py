"""Groups of rows with a weight of their own (reversals), and interval rows (a joint at rest): types, accumulation.

Holds how many interval rows are kept of an equation (1,000).

Which rows form a group, and why, is known to whoever makes the rows. There are three kinds. *Weighted* rows take part
in the fit with a weight of their own, because their noise is not that of the others: a few noisy rows could outweigh
all others. *Counted* rows take part in the fit like all others, and their residual is also known by itself. *Interval*
rows take no part in the fit: each says that Y lies between the predictions of two rows of W.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.estimation.qr_decomposition import (
    add_rows_to_factors,
    compute_r_factor,
    concatenate_stacks,
    join_factors,
    pad_to_square,
)


@dataclass(frozen=True, eq=False)
class BlockRows:
    """Rows of [W | Y] of one equation with p columns that are counted by themselves, in s blocks of time.

    Parameters
    ----------
    rows : (s, k, p + 1)
        Rows with the same inner products as those of each block, zero where a block has fewer than k.
    counts : (s,)
        Number of rows of the recording that each block has.
    """

    rows: FloatArray
    counts: IndexArray

    @property
    def measured_squares(self) -> float:
        """Sum of squared Y."""
        return float((self.rows[:, :, -1] ** 2).sum())

    @property
    def count(self) -> int:
        """Number of rows."""
        return int(self.counts.sum())

    @property
    def row_group(self) -> RowGroup:
        """The rows, no longer by blocks."""
        return RowGroup(pad_to_square(compute_r_factor(self.rows.reshape(-1, self.rows.shape[2]))), self.count)

    def sum_squares(self, values: FloatArray) -> float:
        """Return the sum of squared residuals of parameters (p,)."""
        return float(self.sum_block_squares(values).sum())

    def sum_block_squares(self, values: FloatArray) -> FloatArray:
        """Return the sum of squared residuals of parameters (p,) in every block (s,)."""
        residual = self.rows[:, :, -1] - self.rows[:, :, :-1] @ values
        return np.asarray((residual * residual).sum(axis=1))

    def select(self, selected: Sequence[int]) -> Self:
        """Return the same rows with only these of the p + 1 columns."""
        return replace(self, rows=self.rows[:, :, selected])

    def combine_columns(self, change: FloatArray) -> Self:
        """Return the same rows with combined columns: [W | Y] change (p + 1, p' + 1)."""
        return replace(self, rows=self.rows @ change)

    @classmethod
    def from_factors(cls, factors: FloatArray, counts: IndexArray) -> BlockRows:
        """Build from factors (s, m, p + 1), without the rows that are zero in all blocks.

        Parameters
        ----------
        factors : (s, m, p + 1)
            Triangular factors of the rows of each block.
        counts : (s,)
            Number of rows that each factor stands for.
        """
        # A factor may have more rows than any block fills.
        filled = factors.any(axis=2).any(axis=0)
        return BlockRows(factors[:, filled], counts)

    @classmethod
    def from_parts(cls, parts: Sequence[BlockRows]) -> BlockRows:
        """Concatenate the blocks of several recordings."""
        # Recordings differ in their number of such rows; zero rows change no inner product.
        return BlockRows(
            concatenate_stacks([part.rows for part in parts]), np.concatenate([part.counts for part in parts])
        )


@dataclass(frozen=True, eq=False)
class WeightedRows(BlockRows):
    """Rows of one equation that have a weight of their own, and the factors of its other rows.

    Parameters
    ----------
    rows : (s, k, p + 1)
        Rows of the group, without their weight.
    counts : (s,)
        Number of rows of the recording in the group.
    others : (s, m, p + 1)
        Factors of [W | Y] of all rows but those of the group.
    weight : float
        Weight of a squared residual of the group relative to one of the other rows.
    """

    others: FloatArray
    weight: float = 1.0

    @cached_property
    def whole_parts(self) -> tuple[FloatArray, FloatArray]:
        """Factors (p + 1, p + 1) of the other rows and of the group's, without its weight, of all blocks together."""
        return join_factors(self.others), self.row_group.factor

    @property
    def whole_factor(self) -> FloatArray:
        """Factor (p + 1, p + 1) of all rows of all blocks, as they are weighted."""
        others, group = self.whole_parts
        return pad_to_square(compute_r_factor(np.concatenate([others, np.sqrt(self.weight) * group])))

    def change_weight(self, weight: float) -> WeightedRows:
        """Return the same rows with another weight of the group."""
        changed = replace(self, weight=weight)
        # These do not depend on the weight, and weights are found in many rounds.
        changed.__dict__["whole_parts"] = self.whole_parts
        return changed

    @property
    def weighted_factors(self) -> FloatArray:
        """Factor (s, m, p + 1) of all rows of every block, as they are weighted."""
        # The weight is that of squares; rows take its root. Blocks in which the group has no row stay as they are.
        return add_rows_to_factors(self.others, np.sqrt(self.weight) * self.rows)

    def select(self, selected: Sequence[int]) -> WeightedRows:
        """Return the same rows with only these of the p + 1 columns."""
        return self._replace_rows(self.others[:, :, selected], self.rows[:, :, selected])

    def combine_columns(self, change: FloatArray) -> WeightedRows:
        """Return the same rows with combined columns: [W | Y] change (p + 1, p' + 1)."""
        return self._replace_rows(self.others @ change, self.rows @ change)

    @classmethod
    def join(cls, parts: Sequence[WeightedRows]) -> WeightedRows:
        """Concatenate the blocks of several recordings, every row with a weight of 1."""
        rows = BlockRows.from_parts(parts)
        return cls(rows.rows, rows.counts, concatenate_stacks([part.others for part in parts]))

    def _replace_rows(self, others: FloatArray, rows: FloatArray) -> WeightedRows:
        return replace(self, others=compute_r_factor(others), rows=rows)


MOST_INTERVAL_ROWS = 1000
"""Largest number of interval rows that are kept of one equation of a recording. Of more, every so many-th is kept."""


@dataclass(frozen=True, eq=False)
class RowGroup:
    """Rows that take part in the fit and whose residual is also known separately.

    Parameters
    ----------
    factor : (p + 1, p + 1)
        Triangular factor of [W | Y] of these rows.
    count : int
        Number of rows.
    """

    factor: FloatArray
    count: int

    def sum_squares(self, values: FloatArray) -> float:
        """Return the sum of squared residuals for parameters (p,)."""
        rest = self.factor[:, -1] - self.factor[:, :-1] @ values
        return float(rest @ rest)

    @property
    def measured_squares(self) -> float:
        """Sum of squared Y."""
        return float(self.factor[:, -1] @ self.factor[:, -1])

    def select(self, selected: Sequence[int]) -> RowGroup:
        """Return the same rows with only the columns `picked`."""
        return RowGroup(pad_to_square(compute_r_factor(self.factor[:, [*selected, -1]])), self.count)

    def combine_columns(self, change: FloatArray) -> RowGroup:
        """Return the same rows with combined columns: [W | Y] change, with change (p + 1, p' + 1)."""
        return RowGroup(pad_to_square(compute_r_factor(self.factor @ change)), self.count)

    @classmethod
    def from_parts(cls, parts: Sequence[RowGroup]) -> RowGroup:
        """Join the rows of several recordings."""
        factor = pad_to_square(compute_r_factor(np.concatenate([part.factor for part in parts])))
        return cls(factor, sum(part.count for part in parts))


@dataclass(frozen=True, eq=False)
class IntervalRows:
    """Rows of one equation with p columns that say that Y lies between two predictions; they take no part in the fit.

    Parameters
    ----------
    upper, lower : (m, p)
        The two rows of W of each; which of them predicts more depends on the parameters.
    y : (m,)
        What was measured.
    weights : (m,)
        Number of rows that each of these rows stands for.
    """

    upper: FloatArray
    lower: FloatArray
    y: FloatArray
    weights: FloatArray

    def sum_squares(self, values: FloatArray) -> float:
        """Return the weighted sum of squared distances of y to the intervals of parameters (p,)."""
        return float(self.weights @ compute_band_distance(self.y, self.lower @ values, self.upper @ values) ** 2)

    @property
    def measured_squares(self) -> float:
        """Sum of squared Y."""
        return float(self.weights @ self.y**2)

    @property
    def count(self) -> float:
        """Number of rows that these stand for."""
        return float(self.weights.sum())

    def select(self, selected: Sequence[int]) -> IntervalRows:
        """Return the same rows with only the columns `picked`."""
        return replace(self, upper=self.upper[:, selected], lower=self.lower[:, selected])

    def combine_columns(self, change: FloatArray) -> IntervalRows:
        """Return the same rows with combined columns of W: W change, with change (p, p')."""
        return replace(self, upper=self.upper @ change, lower=self.lower @ change)

    @classmethod
    def from_parts(cls, parts: Sequence[IntervalRows]) -> IntervalRows:
        """Join the rows of several recordings."""
        return cls(*(np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(cls)))


@dataclass(frozen=True, eq=False)
class SeparateRows:
    """Rows of one equation with p columns that are counted by themselves.

    Parameters
    ----------
    fixed : RowGroup or None
        Rows in the fit whose weight can no longer be changed; None where the equation keeps them by blocks of time
        (`WeightedRows`).
    counted : BlockRows
        Further rows in the fit, which weigh as much as all others.
    interval : IntervalRows
        Rows that are not in the fit.
    """

    fixed: RowGroup | None
    counted: BlockRows
    interval: IntervalRows

    def select(self, places: Sequence[int]) -> SeparateRows:
        """Return the same rows with only the columns at `places`."""
        selected = list(places)
        fixed = None if self.fixed is None else self.fixed.select(selected)
        return SeparateRows(fixed, self.counted.select([*selected, -1]), self.interval.select(selected))

    def combine_columns(self, change: FloatArray) -> SeparateRows:
        """Return the same rows with combined columns: [W | Y] change (p + 1, p' + 1), where Y must stay as it is."""
        fixed = None if self.fixed is None else self.fixed.combine_columns(change)
        # Interval rows keep W and y apart, because the interval needs both: only the columns of W are combined.
        return SeparateRows(
            fixed, self.counted.combine_columns(change), self.interval.combine_columns(change[:-1, :-1])
        )


def compute_band_distance(y: FloatArray, first_bound: FloatArray, second_bound: FloatArray) -> FloatArray:
    """Return the signed distance of y to the band between two bounds.

    Parameters
    ----------
    y, first_bound, second_bound : arrays
        Torque and the two bounds, N m or N: of any shape, the same for all three. The bounds may be in either order.

    Returns
    -------
    array
        Distance of that shape, N m or N: zero inside the band, positive above it.
    """
    return np.asarray(y - np.clip(y, np.minimum(first_bound, second_bound), np.maximum(first_bound, second_bound)))


def join_separate_rows(parts: Sequence[SeparateRows | None]) -> SeparateRows | None:
    """Join the rows of several recordings that are counted separately; None where one recording does not have them."""
    # If one recording did not collect them, their errors over all recordings together are not known.
    known = [part for part in parts if part is not None]
    if len(known) < len(parts) or not known:
        return None
    fixed = [part.fixed for part in known if part.fixed is not None]
    return SeparateRows(
        RowGroup.from_parts(fixed) if len(fixed) == len(known) else None,
        BlockRows.from_parts([part.counted for part in known]),
        IntervalRows.from_parts([part.interval for part in known]),
    )


class IntervalRowAccumulator:
    """Collects the interval rows of one equation, as they come.

    Parameters
    ----------
    n_columns : int
        Number of columns p of the equation.
    """

    def __init__(self, n_columns: int) -> None:
        self._p = n_columns
        self._parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def push(self, upper: FloatArray, lower: FloatArray, y: FloatArray) -> None:
        """Add rows.

        Parameters
        ----------
        upper, lower : (m, p)
            The two rows of W of each.
        y : (m,)
            What was measured.
        """
        if len(y):
            self._parts.append((upper, lower, y))

    def finish(self) -> SeparateRows:
        """Return all rows that were collected, thinned to at most `MOST_INTERVAL_ROWS`."""
        parts = self._parts or [(np.zeros((0, self._p)), np.zeros((0, self._p)), np.zeros(0))]
        upper, lower, y = (np.concatenate(items) for items in zip(*parts, strict=True))
        # Ceiling division. The rows that stay count for the ones left out, so that sums over them keep their size.
        stride = -(-len(y) // MOST_INTERVAL_ROWS) if len(y) else 1
        weights = np.full(len(y[::stride]), len(y) / max(len(y[::stride]), 1))
        interval = IntervalRows(upper[::stride], lower[::stride], y[::stride], weights)
        return SeparateRows(None, BlockRows(np.zeros((0, 0, self._p + 1)), np.zeros(0, dtype=np.intp)), interval)
