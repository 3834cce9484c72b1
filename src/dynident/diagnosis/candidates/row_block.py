"""One joint's rows themselves, where a stretch has fewer of them than a model has columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.batches import Amplitudes, Batch
from dynident.diagnosis.candidates.fit import FoldFit, JointSums
from dynident.diagnosis.candidates.products import RowStack, find_present, locate_columns, sum_by_stretch
from dynident.diagnosis.candidates.row_pairs import Pairs


@dataclass(frozen=True, eq=False)
class RowBlock:
    """One joint's `columns` (w + x + 1, m) in some stretches: W of the model, X of the candidates, and Y.

    `have` (w,) says which of the model's columns these are; `place` (c,) where each of the candidates' stands among the
    x that the joint has, ascending, x for those that it lacks. `stretch` (m,) is that of every row, ascending, of
    `n_stretches`; `pairs` the products within candidates that it has a share in. Column by column: what a score takes
    of them is some columns of all rows.
    """

    have: IndexArray
    place: IndexArray
    columns: FloatArray
    stretch: IndexArray
    n_stretches: int
    pairs: Pairs

    @classmethod
    def from_stacks(
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
        have, wp = find_present(where, base)
        place, xp = locate_columns(where, extra)
        needed = np.concatenate([wp, xp, [-1]])
        parts = [stack.columns[needed] for stack in stacks]
        stretch = np.concatenate([stack.stretch for stack in stacks])
        whole = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        if len(stacks) > 1:
            order = np.argsort(stretch, kind="stable")
            whole, stretch = whole.take(order, axis=1), stretch[order]
        return cls(have, place, whole, stretch, n_stretches, Pairs.from_places(place, len(xp), portions))

    @property
    def w(self) -> FloatArray:
        """(w, m)"""
        return self.columns[: len(self.have)]

    @property
    def x(self) -> FloatArray:
        """(x, m)"""
        return self.columns[len(self.have) : -1]

    @property
    def y(self) -> FloatArray:
        """(m,)"""
        return np.asarray(self.columns[-1])

    def select_stretches(self, stretches: IndexArray) -> RowBlock:
        """Of some of the stretches, ascending."""
        number = np.full(self.n_stretches, -1, dtype=np.intp)
        number[stretches] = np.arange(len(stretches))
        stretch = number[self.stretch]
        own = np.flatnonzero(stretch >= 0)
        return replace(self, columns=self.columns.take(own, axis=1), stretch=stretch[own], n_stretches=len(stretches))

    def sum_products(self) -> JointSums:
        """Over all stretches."""
        w, x = len(self.have), len(self.x)
        products = self.w @ self.columns.T
        return JointSums(
            products[:, :w],
            products[:, w : w + x],
            products[:, -1],
            self.x @ self.y,
            self.pairs.compute_products(self.x),
        )

    def compute_errors(self, fit: FoldFit) -> RowErrors:
        """Its squared errors for a fit."""
        return RowErrors(self, fit)


class RowErrors:
    """One joint's squared errors in stretches, for a fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P. `alone` (s,) are those of the model.
    """

    def __init__(self, block: RowBlock, fit: FoldFit) -> None:
        self._block, self._projection = block, fit.projection[block.have]
        self._has = np.flatnonzero(block.place < len(block.x))
        self._rest = block.y - fit.chi[block.have] @ block.w
        self.alone = np.bincount(block.stretch, self._rest**2, block.n_stretches).astype(np.float64)

    def compute_scores(self) -> FloatArray:
        """(s, c): Zᵀρ."""
        scores = -self._add_up(self._block.w * self._rest).T @ self._projection
        scores[:, self._has] += self._add_up(self._block.x * self._rest).T
        return np.asarray(scores)

    def compute_errors_with(self, amplitudes: Amplitudes) -> FloatArray:
        """(g, s): squared errors with each candidate, portion by portion."""
        # What a fold does not determine may be beyond all numbers elsewhere: no gain, whatever it is.
        with np.errstate(over="ignore", invalid="ignore"):
            residuals = amplitudes.model_adjustments[:, self._block.have] @ self._block.w
            residuals += self._rest
            # Most candidates have columns of their own on few joints.
            rows, own = amplitudes.select_own_columns(self._has)
            residuals[rows] -= own @ self._block.x
            np.square(residuals, out=residuals)
            return np.asarray(np.nan_to_num(self._add_up(residuals), nan=np.inf))

    def _add_up(self, values: FloatArray) -> FloatArray:
        return sum_by_stretch(values, self._block.stretch, self._block.n_stretches)
