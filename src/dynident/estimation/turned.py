"""Rows of a joint's equation at reversals, kept separate from its other rows by blocks of time.

At a reversal dry friction changes its sign. A model in which it jumps is wrong by many times the noise: the instant is
known only within some milliseconds, and real friction does not jump. A few of these rows may outweigh all others where
the motion is small, so they have a noise of their own, and a weight from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.estimation.beside import RowGroup
from dynident.estimation.triangles import compute_r_factor, pad_to_square


@dataclass(frozen=True, eq=False)
class ReversalRows:
    """Factors of [W | Y] of the two kinds of rows of one equation with p columns, in s blocks of time.

    Parameters
    ----------
    others : (s, p + 1, p + 1)
        Of all rows but those at reversals.
    rows : (s, k, p + 1)
        Of the rows at reversals.
    counts : (s,)
        Number of rows at reversals.
    weight : float
        Weight of a squared residual at a reversal relative to one of the other rows.
    """

    others: FloatArray
    rows: FloatArray
    counts: IndexArray
    weight: float = 1.0

    @property
    def weighted_factors(self) -> FloatArray:
        """Factor (s, p + 1, p + 1) of all rows of every block, as they are weighted."""
        if not len(self.others):
            return self.others
        return pad_to_square(compute_r_factor(np.concatenate([self.others, np.sqrt(self.weight) * self.rows], axis=1)))

    @property
    def measured_squares(self) -> float:
        """Sum of squared Y at reversals."""
        return float((self.rows[:, :, -1] ** 2).sum())

    @property
    def count(self) -> int:
        """Number of rows at reversals."""
        return int(self.counts.sum())

    @property
    def row_group(self) -> RowGroup:
        """The rows at reversals, no longer by blocks."""
        return RowGroup(pad_to_square(compute_r_factor(self.rows.reshape(-1, self.rows.shape[2]))), self.count)

    def sum_squares(self, values: FloatArray) -> float:
        """Return the sum of squared residuals of parameters (p,) at reversals."""
        rest = self.rows[:, :, -1] - self.rows[:, :, :-1] @ values
        return float((rest * rest).sum())

    def select(self, picked: Sequence[int]) -> ReversalRows:
        """Return the same rows with only these of the p + 1 columns."""
        return self._replace_rows(self.others[:, :, picked], self.rows[:, :, picked])

    def combine_columns(self, change: FloatArray) -> ReversalRows:
        """Return the same rows with combined columns: [W | Y] change (p + 1, p' + 1)."""
        return self._replace_rows(self.others @ change, self.rows @ change)

    @classmethod
    def from_factors(cls, others: FloatArray, turning: FloatArray, counts: IndexArray) -> ReversalRows:
        """Build from factors (s, p + 1, p + 1) of either kind.

        Rows of the second kind that are zero in all blocks are dropped.
        """
        most = int(np.count_nonzero(turning.any(axis=2).any(axis=0)))
        return cls(others, turning[:, :most], counts)

    @classmethod
    def from_parts(cls, parts: Sequence[ReversalRows]) -> ReversalRows:
        """Concatenate the blocks of several recordings, every row with a weight of 1."""
        most = max(part.rows.shape[1] for part in parts)
        # Recordings differ in their number of rows at reversals; zero rows change no inner product.
        rows = [np.pad(part.rows, [(0, 0), (0, most - part.rows.shape[1]), (0, 0)]) for part in parts]
        others, counts = (np.concatenate(items) for items in zip(*((p.others, p.counts) for p in parts), strict=True))
        return cls(others, np.concatenate(rows), counts)

    def _replace_rows(self, others: FloatArray, rows: FloatArray) -> ReversalRows:
        return replace(
            self,
            others=pad_to_square(compute_r_factor(others)) if len(others) else _make_empty_factors(rows),
            rows=rows,
        )


def _make_empty_factors(rows: FloatArray) -> FloatArray:
    return np.zeros((0, rows.shape[-1], rows.shape[-1]))
