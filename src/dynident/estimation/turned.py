"""Rows of a joint's equation where it turns round, told from its others by stretches of time.

There dry friction changes its sign, and a model that has it jump is wrong by many times the noise: the instant is
known within some milliseconds, and real friction does not jump. A few of these rows may outweigh all others where the
motion is small, so they have a noise of their own, and a weight from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.estimation.beside import Apart
from dynident.estimation.triangles import squared, triangular


@dataclass(frozen=True, eq=False)
class Turned:
    """Factors of [W | Y] of the two kinds of rows of one equation with p columns, in s stretches.

    `others` (s, p + 1, p + 1): of all rows but those where the joint turns round; `rows` (s, k, p + 1): of these, of
    which there are `counts` (s,). `weight`: what the square of one of these counts for beside that of another row.
    """

    others: FloatArray
    rows: FloatArray
    counts: IndexArray
    weight: float = 1.0

    @property
    def together(self) -> FloatArray:
        """(s, p + 1, p + 1): the factor of all rows of every stretch, as they are weighed."""
        if not len(self.others):
            return self.others
        return squared(triangular(np.concatenate([self.others, np.sqrt(self.weight) * self.rows], axis=1)))

    @property
    def measured(self) -> float:
        """Sum of squared Y where the joint turns round."""
        return float((self.rows[:, :, -1] ** 2).sum())

    @property
    def count(self) -> int:
        """Number of rows where the joint turns round."""
        return int(self.counts.sum())

    @property
    def in_one(self) -> Apart:
        """The rows where the joint turns round, no longer by stretches."""
        return Apart(squared(triangular(self.rows.reshape(-1, self.rows.shape[2]))), self.count)

    def squares(self, values: FloatArray) -> float:
        """Squared residual of parameters (p,) where the joint turns round."""
        rest = self.rows[:, :, -1] - self.rows[:, :, :-1] @ values
        return float((rest * rest).sum())

    def select(self, picked: Sequence[int]) -> Turned:
        """The same with only these of the p + 1 columns."""
        return self._with(self.others[:, :, picked], self.rows[:, :, picked])

    def combined(self, change: FloatArray) -> Turned:
        """The same with columns that are combinations: [W | Y] change (p + 1, p' + 1)."""
        return self._with(self.others @ change, self.rows @ change)

    @classmethod
    def apart(cls, others: FloatArray, turning: FloatArray, counts: IndexArray) -> Turned:
        """From factors (s, p + 1, p + 1) of either kind: of the second as many rows are kept as are not all zero."""
        most = int(np.count_nonzero(turning.any(axis=2).any(axis=0)))
        return cls(others, turning[:, :most], counts)

    @classmethod
    def joined(cls, parts: Sequence[Turned]) -> Turned:
        """Those of several recordings, behind one another, every row with a weight of 1."""
        most = max(part.rows.shape[1] for part in parts)
        rows = [np.pad(part.rows, [(0, 0), (0, most - part.rows.shape[1]), (0, 0)]) for part in parts]
        others, counts = (np.concatenate(items) for items in zip(*((p.others, p.counts) for p in parts), strict=True))
        return cls(others, np.concatenate(rows), counts)

    def _with(self, others: FloatArray, rows: FloatArray) -> Turned:
        return replace(self, others=squared(triangular(others)) if len(others) else _empty(rows), rows=rows)


def _empty(rows: FloatArray) -> FloatArray:
    return np.zeros((0, rows.shape[-1], rows.shape[-1]))
