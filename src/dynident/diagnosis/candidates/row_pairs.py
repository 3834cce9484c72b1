"""XᵀX within candidates, of one joint's rows: few candidates have more than one column there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.batches import Batch


@dataclass(frozen=True, eq=False)
class _SharedColumns:
    """Candidates with p columns on the joint: these (g, p), and where their products (g, p, p) belong."""

    columns: IndexArray
    where: IndexArray


@dataclass(frozen=True, eq=False)
class Pairs:
    """Where products within candidates belong among those of all portions in a row, `size` of them.

    `squares` (d,) of the columns `own` (d,); `several` those of candidates that have more than one of them.
    """

    size: int
    squares: IndexArray
    own: IndexArray
    several: tuple[_SharedColumns, ...]

    @classmethod
    def from_places(cls, place: IndexArray, n_columns: int, portions: Sequence[Batch]) -> Pairs:
        """Of a joint that has `n_columns` of the candidates': the `place` (c,) of each, at the end if it lacks it."""
        squares, own, several, start = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)], [], 0
        for portion in portions:
            k = portion.width
            places = place[portion.columns]
            has = places < n_columns
            flat = start + np.arange(places.size * k).reshape(-1, k, k)
            squares.append(np.einsum("gkk->gk", flat)[has])
            own.append(places[has])
            counts = has.sum(axis=1)
            for p in sorted(set(counts[counts > 1].tolist())):
                members = np.flatnonzero(counts == p)
                which = np.nonzero(has[members])[1].reshape(-1, p)
                rows = members[:, None]
                where = flat[rows[:, :, None], which[:, :, None], which[:, None, :]]
                several.append(_SharedColumns(places[rows, which], where))
            start += places.size * k
        return cls(start, np.concatenate(squares), np.concatenate(own), tuple(several))

    def compute_products(self, x: FloatArray) -> FloatArray:
        """(size,): of the columns x (c, m)."""
        products = np.zeros(self.size)
        products[self.squares] = np.einsum("cm,cm->c", x, x)[self.own]
        for group in self.several:
            columns = x[group.columns]
            products[group.where] = columns @ columns.transpose(0, 2, 1)
        return products
