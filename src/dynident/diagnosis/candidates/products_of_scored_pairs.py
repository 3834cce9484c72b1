"""Select from all inner products, joint by joint, those that one round of scores needs.

Products of two candidates with each other are never needed, and there are very many of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.fold_fit import (
    Amplitudes,
    Batch,
    FoldFit,
    JointSums,
    OwnColumns,
    ProductSums,
    list_extra_columns,
    split_batches,
    split_by_portion,
)
from dynident.diagnosis.candidates.time_blocks_and_folds import (
    Products,
    RowStack,
    find_present,
    locate_columns,
    sum_by_block,
)


@dataclass(frozen=True, eq=False)
class _SharedColumns:
    """Candidates with p columns on the joint: these (g, p), and where their products (g, p, p) belong."""

    columns: IndexArray
    where: IndexArray


@dataclass(frozen=True, eq=False)
class Pairs:
    """Where products within candidates belong among those of all portions in a row.

    Parameters
    ----------
    size : int
        Number of products within candidates, all portions in a row.
    squares, own : (d,)
        Places of the squares of columns, and the columns that they are of.
    several : tuple of _SharedColumns
        Places of the products of candidates with several columns.
    """

    size: int
    squares: IndexArray
    own: IndexArray
    several: tuple[_SharedColumns, ...]

    @classmethod
    def from_places(cls, place: IndexArray, n_columns: int, portions: Sequence[Batch]) -> Pairs:
        """Find the places for one joint."""
        squares, own, several, start = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)], [], 0
        for portion in portions:
            k = portion.width
            places = place[portion.columns]
            has = places < n_columns
            flat = start + np.arange(places.size * k).reshape(-1, k, k)
            squares.append(np.einsum("gkk->gk", flat)[has])
            own.append(places[has])
            counts = has.sum(axis=1)
            # Candidates that share a number of columns are multiplied at once, as a stack of small matrices.
            for p in sorted(set(counts[counts > 1].tolist())):
                members = np.flatnonzero(counts == p)
                which = np.nonzero(has[members])[1].reshape(-1, p)
                rows = members[:, None]
                where = flat[rows[:, :, None], which[:, :, None], which[:, None, :]]
                several.append(_SharedColumns(places[rows, which], where))
            start += places.size * k
        return cls(start, np.concatenate(squares), np.concatenate(own), tuple(several))

    def compute_products(self, x: FloatArray) -> FloatArray:
        """Return the products (size,) of columns x (c, m)."""
        products = np.zeros(self.size)
        products[self.squares] = np.einsum("cm,cm->c", x, x)[self.own]
        for group in self.several:
            columns = x[group.columns]
            products[group.where] = columns @ columns.transpose(0, 2, 1)
        return products


@dataclass(frozen=True, eq=False)
class ProductBlock:
    """Products of one joint over some blocks: of the model's columns W that it has, the candidates' X, and Y.

    Parameters
    ----------
    have : (w,)
        Columns of the model that the joint has.
    place : (c,)
        Where each column of the candidates stands among the x that the joint has; at the end, where there are zeros,
        for those that it lacks.
    ww, wx, wy : (s, w, w), (s, w, x + 1), (s, w)
        WᵀW, WᵀX and Wᵀy by block.
    xy, yy : (s, x + 1), (s,)
        Xᵀy and yᵀy by block.
    pairs : tuple of (s, g, k, k)
        XᵀX within the candidates of each portion.
    portions : tuple of Batch
        The candidates, by number of columns.
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

    def select_blocks(self, blocks: IndexArray) -> ProductBlock:
        """Return the same for some of the blocks."""
        ww, wx, wy, xy, yy = (products[blocks] for products in (self.ww, self.wx, self.wy, self.xy, self.yy))
        pairs = tuple(own[blocks] for own in self.pairs)
        return ProductBlock(self.have, self.place, ww, wx, wy, xy, yy, pairs, self.portions)

    def sum_products(self) -> JointSums:
        """Return the sums over all blocks."""
        return JointSums(
            self.ww.sum(axis=0),
            self.wx.sum(axis=0)[:, :-1],
            self.wy.sum(axis=0),
            self.xy.sum(axis=0)[:-1],
            np.concatenate([np.zeros(0), *(pairs.sum(axis=0).ravel() for pairs in self.pairs)]),
        )

    def compute_errors(self, fit: FoldFit) -> ProductErrors:
        """Return the squared errors for a fit."""
        return ProductErrors(self, fit)


class ProductErrors:
    """One joint's squared errors in blocks, for a fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P. `alone` (s,) are those of the model.
    """

    def __init__(self, block: ProductBlock, fit: FoldFit) -> None:
        self._block = block
        chi = fit.chi[block.have]
        self._projection = fit.projection[block.have]
        # |y - W χ|² from products alone. It is a small difference of large numbers, which rounding may make negative.
        errors = block.yy - 2 * block.wy @ chi + np.einsum("i,sij,j->s", chi, block.ww, chi)
        self.alone = np.maximum(errors, 0.0)
        # Wᵀρ (s, w) and Xᵀρ (s, x + 1) of what the model leaves.
        self._w_rest = block.wy - block.ww @ chi
        self._x_rest = block.xy - chi @ block.wx

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c) by block and column."""
        return np.asarray(self._x_rest[:, self._block.place] - self._w_rest @ self._projection)

    def compute_errors_with(self, amplitudes: Amplitudes) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion."""
        each = zip(self._block.portions, self._block.pairs, amplitudes.each, strict=True)
        return np.concatenate([self._compute_portion_errors(portion, pairs, own) for portion, pairs, own in each])

    def _compute_portion_errors(self, portion: Batch, pairs: FloatArray, amplitudes: FloatArray) -> FloatArray:
        """Return the squared errors (g, s) with each candidate of a portion."""
        block = self._block
        shift = np.einsum("bgk,gk->bg", self._projection[:, portion.columns], amplitudes)
        along = -(self._w_rest @ shift)
        size = np.einsum("sbg,bg->sg", block.ww @ shift, shift)
        size += np.einsum("sgkl,gk,gl->sg", pairs, amplitudes, amplitudes)
        places = block.place[portion.columns]
        # Column by column: all at once would need an array of blocks, model columns and candidates.
        for k in range(portion.width):
            own, place = amplitudes[:, k], places[:, k]
            along += own * self._x_rest[:, place]
            size -= 2 * own * np.einsum("sbg,bg->sg", block.wx[:, :, place], shift)
        return np.asarray(np.maximum(self.alone[:, None] - 2 * along + size, 0.0).T)


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Rows of one joint in some blocks: W of the model, X of the candidates, and Y.

    Parameters
    ----------
    have : (w,)
        Columns of the model that the joint has.
    place : (c,)
        Where each column of the candidates stands among the x that the joint has, x for those that it lacks.
    columns : (w + x + 1, m)
        W of the model, X of the candidates, and Y, column by column: a score takes some columns of all rows.
    row_block : (m,)
        Number of the block of each row, ascending.
    n_blocks : int
        Number of blocks.
    pairs : Pairs
        Products within candidates that the joint has a share in.
    own : OwnColumns
        Candidates that have columns of their own on the joint.
    """

    have: IndexArray
    place: IndexArray
    columns: FloatArray
    row_block: IndexArray
    n_blocks: int
    pairs: Pairs
    own: OwnColumns

    @classmethod
    def from_stacks(
        cls,
        stacks: Sequence[RowStack],
        where: IndexArray,
        columns: tuple[IndexArray, IndexArray],
        portions: Sequence[Batch],
        n_blocks: int,
    ) -> RowBlock:
        """Take what is needed out of a joint's rows."""
        base, extra = columns
        have, wp = find_present(where, base)
        place, xp = locate_columns(where, extra)
        needed = np.concatenate([wp, xp, [-1]])
        parts = [stack.columns[needed] for stack in stacks]
        row_block = np.concatenate([stack.row_block for stack in stacks])
        whole = parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)
        # Rows of several kinds are merged by block, since sums by block need them in order.
        if len(stacks) > 1:
            order = np.argsort(row_block, kind="stable")
            whole, row_block = whole.take(order, axis=1), row_block[order]
        pairs = Pairs.from_places(place, len(xp), portions)
        own = OwnColumns.from_places(place, len(xp), portions)
        return cls(have, place, whole, row_block, n_blocks, pairs, own)

    @property
    def w(self) -> FloatArray:
        """Columns of the model (w, m)."""
        return self.columns[: len(self.have)]

    @property
    def x(self) -> FloatArray:
        """Columns of the candidates (x, m)."""
        return self.columns[len(self.have) : -1]

    @property
    def y(self) -> FloatArray:
        """Torque (m,)."""
        return np.asarray(self.columns[-1])

    def select_blocks(self, blocks: IndexArray) -> RowBlock:
        """Return the same for some of the blocks, ascending."""
        # Blocks are numbered anew; the rows of all others get -1 and drop out.
        number = np.full(self.n_blocks, -1, dtype=np.intp)
        number[blocks] = np.arange(len(blocks))
        row_block = number[self.row_block]
        own = np.flatnonzero(row_block >= 0)
        return replace(self, columns=self.columns.take(own, axis=1), row_block=row_block[own], n_blocks=len(blocks))

    def sum_products(self) -> JointSums:
        """Return the sums over all blocks."""
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
        """Return the squared errors for a fit."""
        return RowErrors(self, fit)


class RowErrors:
    """What `ProductErrors` are, from the rows themselves."""

    def __init__(self, block: RowBlock, fit: FoldFit) -> None:
        self._block, self._projection = block, fit.projection[block.have]
        self._has = np.flatnonzero(block.place < len(block.x))
        self._rest = block.y - fit.chi[block.have] @ block.w
        self.alone = np.bincount(block.row_block, self._rest**2, block.n_blocks).astype(np.float64)

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c) by block and column."""
        scores = -self._add_up(self._block.w * self._rest).T @ self._projection
        scores[:, self._has] += self._add_up(self._block.x * self._rest).T
        return np.asarray(scores)

    def compute_errors_with(self, amplitudes: Amplitudes) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion."""
        # What a fold does not determine may be beyond all numbers elsewhere: no gain, whatever it is.
        with np.errstate(over="ignore", invalid="ignore"):
            # The model's own parameters are other ones beside a candidate.
            residuals = amplitudes.model_adjustments[:, self._block.have] @ self._block.w
            residuals += self._rest
            # Most candidates have columns of their own on few joints.
            if len(own := self._block.own.candidates):
                residuals[own] -= self._block.own.combine(amplitudes, self._block.x)
            np.square(residuals, out=residuals)
            return np.asarray(np.nan_to_num(self._add_up(residuals), nan=np.inf))

    def _add_up(self, values: FloatArray) -> FloatArray:
        return sum_by_block(values, self._block.row_block, self._block.n_blocks)


class JointErrors(Protocol):
    """One joint's squared errors in blocks, for a fit on others."""

    @property
    def alone(self) -> FloatArray:
        """Squared errors (s,) of the model alone."""

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c): Z is what the model leaves of each candidate's column, ρ the same of Y."""

    def compute_errors_with(self, amplitudes: Amplitudes) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion."""


class JointBlock(Protocol):
    """One joint's share: which of the model's columns it has, `have` (w,), and where those of candidates are."""

    @property
    def have(self) -> IndexArray:
        """(w,): which of the model's columns the joint has."""

    @property
    def place(self) -> IndexArray:
        """(c,): where each of the candidates' columns stands among the x that the joint has, x where it lacks it."""

    def select_blocks(self, blocks: IndexArray) -> JointBlock:
        """Return the same for some of the blocks."""

    def sum_products(self) -> JointSums:
        """Return the sums over all blocks."""

    def compute_errors(self, fit: FoldFit) -> JointErrors:
        """Return the squared errors for a fit."""


@dataclass(frozen=True, eq=False)
class JointBlocks:
    """Rows or products of all joints, for a model and candidates beside it.

    Parameters
    ----------
    n_base : int
        Number of columns b of the model.
    n_extra : int
        Number of columns c of the candidates.
    n_blocks : int
        Number of blocks.
    portions : tuple of Batch
        The candidates, by number of columns.
    joints : tuple of JointBlock
        Rows or products of each joint.
    """

    n_base: int
    n_extra: int
    n_blocks: int
    portions: tuple[Batch, ...]
    joints: tuple[JointBlock, ...]

    @classmethod
    def from_products(cls, data: Products, base: IndexArray, candidates: Sequence[Candidate]) -> JointBlocks:
        """Take what is needed to score candidates beside a model."""
        extra = list_extra_columns(candidates)
        portions = split_batches(candidates, extra)
        joints = tuple(_build_block(data, joint, base, extra, portions) for joint in range(data.n_joints))
        return cls(len(base), len(extra), data.n_blocks, portions, joints)

    def select_blocks(self, blocks: IndexArray) -> JointBlocks:
        """Return the same for some of the blocks."""
        joints = tuple(joint.select_blocks(blocks) for joint in self.joints)
        return JointBlocks(self.n_base, self.n_extra, len(blocks), self.portions, joints)

    def fit_amplitudes(self, fit: FoldFit) -> Amplitudes:
        """Fit the parameters of each candidate beside the model."""
        each = tuple(fit.fit_amplitudes(number) for number in range(len(self.portions)))
        return Amplitudes(self.portions, each, fit.projection)

    def sum_products(self, noise: FloatArray) -> ProductSums:
        """Return the sums over all blocks and joints, each joint in units of its noise (n,)."""
        b, c = self.n_base, self.n_extra
        ww, wx, wy, xy = np.zeros((b, b)), np.zeros((b, c)), np.zeros(b), np.zeros(c)
        xx = np.zeros(sum(portion.columns.size * portion.width for portion in self.portions))
        for block, sigma in zip(self.joints, noise, strict=True):
            # Rows of a joint count by the inverse of the variance of its noise, as in the fit of the model.
            weight, own = 1.0 / sigma**2, block.sum_products()
            has = np.flatnonzero(block.place < len(own.xy))
            ww[np.ix_(block.have, block.have)] += own.ww * weight
            wx[np.ix_(block.have, has)] += own.wx * weight
            wy[block.have] += own.wy * weight
            xy[has] += own.xy * weight
            xx += own.xx * weight
        return ProductSums(ww, wx, wy, xy, split_by_portion(xx, self.portions))


def _build_block(
    data: Products, joint: int, base: IndexArray, extra: IndexArray, portions: Sequence[Batch]
) -> JointBlock:
    # Rows are used as they are where all of them are at hand; one kind in products makes products of all.
    stacks = [stack for stack in data.stacks[joint] if isinstance(stack, RowStack)]
    if len(stacks) == len(data.stacks[joint]):
        return RowBlock.from_stacks(stacks, data.position[joint], (base, extra), portions, data.n_blocks)
    return ProductBlock.from_products(data, joint, base, extra, portions)
