"""One joint's inner products, where a stretch has more rows than a model has columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.batches import Amplitudes, Batch
from dynident.diagnosis.candidates.fit import FoldFit, JointSums
from dynident.diagnosis.candidates.products import Products, find_present, locate_columns


@dataclass(frozen=True, eq=False)
class ProductBlock:
    """One joint's products over some stretches: of the model's columns W that it has, the candidates' X, and Y.

    `have` (w,) says which of the model's columns these are; `place` (c,) where each of the candidates' stands among the
    x that the joint has: for those that it lacks at the end, where there are zeros. WᵀW (s, w, w), WᵀX (s, w, x + 1),
    Wᵀy (s, w), Xᵀy (s, x + 1), yᵀy (s,); `pairs` are XᵀX within the candidates of every portion (s, g, k, k).
    """

    have: IndexArray
    place: IndexArray
    ww: FloatArray
    wx: FloatArray
    wy: FloatArray
    xy: FloatArray
    yy: FloatArray
    pairs: tuple[FloatArray, ...]
    portions: tuple[Batch, ...]

    @classmethod
    def from_products(
        cls, data: Products, joint: int, base: IndexArray, extra: IndexArray, portions: Sequence[Batch]
    ) -> ProductBlock:
        """Take what is needed out of a joint's products."""
        where = data.position[joint]
        have, wp = find_present(where, base)
        place, xp = locate_columns(where, extra)
        y = np.full(1, int((where >= 0).sum()), dtype=np.intp)
        # Whatever stands at the end for the columns that the joint lacks is set to zero.
        padded = np.append(xp, 0)
        wx, xy = data.take_products(joint, wp[:, None], padded), data.take_products(joint, padded, y)
        wx[:, :, -1], xy[:, -1] = 0.0, 0.0
        pairs = []
        for portion in portions:
            places = where[extra[portion.columns]]
            lacking = places < 0
            places = np.where(lacking, 0, places)
            own = data.take_products(joint, places[:, :, None], places[:, None, :])
            own[:, lacking[:, :, None] | lacking[:, None, :]] = 0.0
            pairs.append(own)
        ww, wy = data.take_products(joint, wp[:, None], wp), data.take_products(joint, wp, y)
        return cls(have, place, ww, wx, wy, xy, data.take_products(joint, y, y)[:, 0], tuple(pairs), tuple(portions))

    def select_stretches(self, stretches: IndexArray) -> ProductBlock:
        """Of some of the stretches."""
        return ProductBlock(
            self.have,
            self.place,
            self.ww[stretches],
            self.wx[stretches],
            self.wy[stretches],
            self.xy[stretches],
            self.yy[stretches],
            tuple(own[stretches] for own in self.pairs),
            self.portions,
        )

    def sum_products(self) -> JointSums:
        """Over all stretches."""
        return JointSums(
            self.ww.sum(axis=0),
            self.wx.sum(axis=0)[:, :-1],
            self.wy.sum(axis=0),
            self.xy.sum(axis=0)[:-1],
            np.concatenate([np.zeros(0), *(pairs.sum(axis=0).ravel() for pairs in self.pairs)]),
        )

    def compute_errors(self, fit: FoldFit) -> ProductErrors:
        """Its squared errors for a fit."""
        return ProductErrors(self, fit)


class ProductErrors:
    """One joint's squared errors in stretches, for a fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P. `alone` (s,) are those of the model.
    """

    def __init__(self, block: ProductBlock, fit: FoldFit) -> None:
        self._block = block
        chi = fit.chi[block.have]
        self._projection = fit.projection[block.have]
        errors = block.yy - 2 * block.wy @ chi + np.einsum("i,sij,j->s", chi, block.ww, chi)
        self.alone = np.maximum(errors, 0.0)
        # Wᵀρ (s, w) and Xᵀρ (s, x + 1) of what the model leaves.
        self._w_rest = block.wy - block.ww @ chi
        self._x_rest = block.xy - chi @ block.wx

    def compute_scores(self) -> FloatArray:
        """(s, c): Zᵀρ."""
        return np.asarray(self._x_rest[:, self._block.place] - self._w_rest @ self._projection)

    def compute_errors_with(self, amplitudes: Amplitudes) -> FloatArray:
        """(g, s): squared errors with each candidate, portion by portion."""
        each = zip(self._block.portions, self._block.pairs, amplitudes.each, strict=True)
        return np.concatenate([self._compute_portion_errors(portion, pairs, own) for portion, pairs, own in each])

    def _compute_portion_errors(self, portion: Batch, pairs: FloatArray, amplitudes: FloatArray) -> FloatArray:
        """(g, s)"""
        block = self._block
        shift = np.einsum("bgk,gk->bg", self._projection[:, portion.columns], amplitudes)
        along = -(self._w_rest @ shift)
        size = np.einsum("sbg,bg->sg", block.ww @ shift, shift)
        size += np.einsum("sgkl,gk,gl->sg", pairs, amplitudes, amplitudes)
        places = block.place[portion.columns]
        for k in range(portion.width):
            own, place = amplitudes[:, k], places[:, k]
            along += own * self._x_rest[:, place]
            size -= 2 * own * np.einsum("sbg,bg->sg", block.wx[:, :, place], shift)
        return np.asarray(np.maximum(self.alone[:, None] - 2 * along + size, 0.0).T)
