"""One joint's rows themselves, where a stretch has fewer of them than a model has columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.batches import Amplitudes, Batch
from dynident.diagnosis.candidates.fit import JointSums, StretchesFit
from dynident.diagnosis.candidates.products import RowStack, added_up, present, standing


@dataclass(frozen=True, eq=False)
class RowBlock:
    """One joint's `columns` (w + x + 2, m) in some stretches: W of the model, X of the candidates, zeros, and Y.

    `have` (w,) says which of the model's columns these are; `place` (c,) where each of the candidates' stands among the
    x that the joint has: for those that it lacks at the end, where there are zeros. `stretch` (m,) is that of every
    row, ascending, of `n_stretches`. Column by column: what a score takes of them is some columns of all rows.
    """

    have: IndexArray
    place: IndexArray
    columns: FloatArray
    stretch: IndexArray
    n_stretches: int
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
        taken = [stack.columns[needed] for stack in stacks]
        stretch = np.concatenate([stack.stretch for stack in stacks])
        whole = taken[0] if len(taken) == 1 else np.concatenate(taken, axis=1)
        if len(stacks) > 1:
            order = np.argsort(stretch, kind="stable")
            whole, stretch = whole.take(order, axis=1), stretch[order]
        whole[-2] = 0.0
        return cls(have, place, whole, stretch, n_stretches, tuple(portions))

    @property
    def w(self) -> FloatArray:
        """(w, m)"""
        return self.columns[: len(self.have)]

    @property
    def x(self) -> FloatArray:
        """(x + 1, m), zeros at the end."""
        return self.columns[len(self.have) : -1]

    @property
    def y(self) -> FloatArray:
        """(m,)"""
        return np.asarray(self.columns[-1])

    def at(self, stretches: IndexArray) -> RowBlock:
        """Of some of the stretches, ascending."""
        number = np.full(self.n_stretches, -1, dtype=np.intp)
        number[stretches] = np.arange(len(stretches))
        stretch = number[self.stretch]
        own = np.flatnonzero(stretch >= 0)
        return replace(self, columns=self.columns.take(own, axis=1), stretch=stretch[own], n_stretches=len(stretches))

    def sums(self) -> JointSums:
        """Over all stretches."""
        w, x = len(self.have), len(self.x) - 1
        products = self.w @ self.columns.T
        return JointSums(
            products[:, :w],
            products[:, w : w + x],
            products[:, -1],
            self.x[:-1] @ self.y,
            np.concatenate([np.zeros(0), *(self._within(portion).ravel() for portion in self.portions)]),
        )

    def errors(self, fit: StretchesFit) -> RowErrors:
        """Its squared errors for a fit."""
        return RowErrors(self, fit)

    def _within(self, portion: Batch) -> FloatArray:
        """XᵀX within the candidates of a portion (g, k, k); most of them have nothing on one joint."""
        places = self.place[portion.columns]
        own = np.flatnonzero((places < len(self.x) - 1).any(axis=1))
        found = np.zeros((*places.shape, portion.width))
        columns = self.x[places[own]]
        if portion.width == 1:
            found[own, :, 0] = np.einsum("gkm,gkm->gk", columns, columns)
        else:
            found[own] = columns @ columns.transpose(0, 2, 1)
        return found


class RowErrors:
    """One joint's squared errors in stretches, for a fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P. `alone` (s,) are those of the model.
    """

    def __init__(self, block: RowBlock, fit: StretchesFit) -> None:
        self._block = block
        self._rest = block.y - fit.chi[block.have] @ block.w
        # Z as (c, m).
        self._beside = -fit.projection[block.have].T @ block.w
        has = np.flatnonzero(block.place < len(block.x) - 1)
        self._beside[has] += block.x[block.place[has]]
        self.alone = np.bincount(block.stretch, self._rest**2, block.n_stretches).astype(np.float64)

    def scores(self) -> FloatArray:
        """(s, c): Zᵀρ."""
        return self._added_up(self._beside * self._rest).T

    def beside(self, amplitudes: Amplitudes) -> FloatArray:
        """(g, s): squared errors with each candidate, portion by portion."""
        # What a fold does not determine may be beyond all numbers elsewhere: no gain, whatever it is.
        with np.errstate(over="ignore", invalid="ignore"):
            left = amplitudes.mixing @ self._beside
            np.subtract(self._rest, left, out=left)
            np.square(left, out=left)
            return np.asarray(np.nan_to_num(self._added_up(left), nan=np.inf))

    def _added_up(self, values: FloatArray) -> FloatArray:
        return added_up(values, self._block.stretch, self._block.n_stretches)
