"""One joint's rows themselves, where a stretch has fewer of them than a model has columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.batches import Batch
from dynident.diagnosis.candidates.fit import JointSums, StretchesFit
from dynident.diagnosis.candidates.products import RowStack, adding, present, standing


@dataclass(frozen=True, eq=False)
class RowBlock:
    """One joint's `rows` (m, w + x + 2) in some stretches: W of the model, X of the candidates, zeros, and Y.

    `have` (w,) says which of the model's columns these are; `place` (c,) where each of the candidates' stands among the
    x that the joint has: for those that it lacks at the end, where there are zeros. `stretch` (m,) is that of every
    row, ascending, of `n_stretches`. `within`: where, in the flat products of all these columns, those within
    candidates are, portion by portion.
    """

    have: IndexArray
    place: IndexArray
    rows: FloatArray
    stretch: IndexArray
    n_stretches: int
    within: IndexArray
    portions: tuple[Batch, ...]

    @classmethod
    def of(
        cls,
        stacks: Sequence[RowStack],
        where: IndexArray,
        columns: tuple[IndexArray, IndexArray],
        portions: Sequence[Batch],
        n_stretches: int,
    ) -> RowBlock:
        """Take what is needed out of a joint's rows.

        Parameters
        ----------
        stacks : its rows, by kind
        where : where every column stands in them
        columns : the model's (b,), and the candidates' (c,)
        """
        base, extra = columns
        have, wp = present(where, base)
        place, xp = standing(where, extra)
        needed = np.concatenate([wp, xp, [-1, -1]])
        rows = np.concatenate([stack.values.take(needed, axis=1) for stack in stacks])
        rows[:, -2] = 0.0
        stretch = np.concatenate([stack.stretch for stack in stacks])
        if len(stacks) > 1:
            order = np.argsort(stretch, kind="stable")
            rows, stretch = rows[order], stretch[order]
        wide = len(needed)
        own = [len(wp) + place[portion.columns] for portion in portions]
        within = [(one[:, :, None] * wide + one[:, None, :]).ravel() for one in own]
        flat = np.concatenate([np.zeros(0, dtype=np.intp), *within])
        return cls(have, place, rows, stretch, n_stretches, flat, tuple(portions))

    @property
    def w(self) -> FloatArray:
        """(m, w)"""
        return self.rows[:, : len(self.have)]

    @property
    def x(self) -> FloatArray:
        """(m, x + 1), zeros at the end."""
        return self.rows[:, len(self.have) : -1]

    @property
    def y(self) -> FloatArray:
        """(m,)"""
        return self.rows[:, -1]

    def at(self, stretches: IndexArray) -> RowBlock:
        """Of some of the stretches, ascending."""
        number = np.full(self.n_stretches, -1, dtype=np.intp)
        number[stretches] = np.arange(len(stretches))
        stretch = number[self.stretch]
        own = np.flatnonzero(stretch >= 0)
        return replace(self, rows=self.rows[own], stretch=stretch[own], n_stretches=len(stretches))

    def sums(self) -> JointSums:
        """Over all stretches."""
        products = self.rows.T @ self.rows
        w, end = len(self.have), len(products) - 2
        return JointSums(
            products[:w, :w],
            products[:w, w:end],
            products[:w, -1],
            products[w:end, -1],
            products.ravel().take(self.within),
        )

    def errors(self, fit: StretchesFit) -> RowErrors:
        """Its squared errors for a fit."""
        return RowErrors(self, fit)


class RowErrors:
    """One joint's squared errors in stretches, for a fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P. `alone` (s,) are those of the model.
    """

    def __init__(self, block: RowBlock, fit: StretchesFit) -> None:
        self._block = block
        self._adding = adding(block.stretch, block.n_stretches)
        self._rest = block.y - block.w @ fit.chi[block.have]
        self._beside = block.w @ -fit.projection[block.have]
        has = np.flatnonzero(block.place < block.x.shape[1] - 1)
        self._beside[:, has] += block.x.take(block.place[has], axis=1)
        self.alone = np.bincount(block.stretch, self._rest**2, block.n_stretches).astype(np.float64)

    def scores(self) -> FloatArray:
        """(s, c): Zᵀρ."""
        return np.asarray(self._adding @ (self._beside * self._rest[:, None]))

    def beside(self, amplitudes: Sequence[FloatArray]) -> FloatArray:
        """(g, s): squared errors with each candidate, portion by portion, whose amplitudes are (g, k)."""
        if not amplitudes:
            return np.zeros((0, self._block.n_stretches))
        single = [portion.columns for portion in self._block.portions]
        left = np.empty((len(self._rest), sum(map(len, single))))
        first = 0
        # What a fold does not determine may be beyond all numbers elsewhere: no gain, whatever it is.
        with np.errstate(over="ignore", invalid="ignore"):
            for columns, own in zip(single, amplitudes, strict=True):
                part = left[:, first : first + len(columns)]
                first += len(columns)
                if columns.shape[1] == 1:
                    np.multiply(self._beside.take(columns[:, 0], axis=1), own[:, 0], out=part)
                else:
                    np.einsum("mgk,gk->mg", self._beside.take(columns, axis=1), own, out=part)
            np.subtract(self._rest[:, None], left, out=left)
            np.square(left, out=left)
        return np.asarray(np.nan_to_num((self._adding @ left).T, nan=np.inf))
