"""Select from all inner products, joint by joint, those that one round of scores needs.

Products of two candidates with each other are never needed, and there are very many of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.fold_fit import (
    Amplitudes,
    Batch,
    FoldFit,
    JointSums,
    OwnColumns,
    Pairs,
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
from dynident.estimation import PriorInformation


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

    def hold_rows(self) -> ProductBlock:
        """Return the same: what there is of the rows is at hand."""
        return self

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


# Numbers of a joint's rows that are read at once: they stay in the cache.
_MOST_VALUES = 2**17


class JointRows(NamedTuple):
    """Rows of one joint in some consecutive blocks, column by column, since a score takes some columns of all rows.

    W of the model (w, m), X of the candidates (x, m), Y (m,), the place (m,) of each row's block among these, and the
    slice of these among all blocks.
    """

    w: FloatArray
    x: FloatArray
    y: FloatArray
    row_block: IndexArray
    blocks: slice

    def add_up(self, values: FloatArray) -> FloatArray:
        """Sum values (..., m) by block (..., s)."""
        return sum_by_block(values, self.row_block, self.blocks.stop - self.blocks.start)


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Which rows and columns of one joint a score takes; they are read when they are needed, and not kept.

    Parameters
    ----------
    have : (w,)
        Columns of the model that the joint has.
    place : (c,)
        Where each column of the candidates stands among the x that the joint has, x for those that it lacks.
    stacks : tuple of RowStack
        The rows of the joint, by kind.
    needed : (w + x + 1,)
        Where the columns of the model, those of the candidates, and Y stand in them.
    blocks : (s,)
        The blocks of time, ascending.
    pairs : Pairs
        Products within candidates that the joint has a share in.
    own : OwnColumns
        Candidates that have columns of their own on the joint.
    held : tuple of JointRows
        The rows, where they were read to be used several times.
    """

    have: IndexArray
    place: IndexArray
    stacks: tuple[RowStack, ...]
    needed: IndexArray
    blocks: IndexArray
    pairs: Pairs
    own: OwnColumns
    held: tuple[JointRows, ...] = ()

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
        pairs = Pairs.from_places(place, len(xp), portions)
        own = OwnColumns.from_places(place, len(xp), portions)
        return cls(have, place, tuple(stacks), np.concatenate([wp, xp, [-1]]), np.arange(n_blocks), pairs, own)

    @property
    def n_columns(self) -> int:
        """Number of columns x of the candidates that the joint has."""
        return len(self.needed) - len(self.have) - 1

    def select_blocks(self, blocks: IndexArray) -> RowBlock:
        """Return the same for some of the blocks, ascending."""
        return replace(self, blocks=self.blocks[blocks], held=())

    def hold_rows(self) -> RowBlock:
        """Return the same with its rows, for several uses of the same few blocks."""
        return replace(self, held=tuple(self.read_rows()))

    def read_rows(self) -> Iterator[JointRows]:
        """Yield the rows, some blocks at a time."""
        if self.held:
            yield from self.held
            return
        ends = np.cumsum(sum(stack.count_rows(self.blocks) for stack in self.stacks))
        most = max(1, _MOST_VALUES // len(self.needed))
        first, w = 0, len(self.have)
        while first < len(self.blocks):
            start = ends[first - 1] if first else 0
            last = max(first + 1, int(np.searchsorted(ends, start + most, side="right")))
            columns, row_block = self._read_blocks(self.blocks[first:last])
            yield JointRows(columns[:w], columns[w:-1], columns[-1], row_block, slice(first, last))
            first = last

    def _read_blocks(self, blocks: IndexArray) -> tuple[FloatArray, IndexArray]:
        parts = [stack.read_blocks(self.needed, blocks) for stack in self.stacks]
        if len(parts) == 1:
            return parts[0]
        # Rows of several kinds are merged by block, since sums by block need them in order.
        row_block = np.concatenate([own for _, own in parts])
        order = np.argsort(row_block, kind="stable")
        return np.concatenate([own for own, _ in parts], axis=1).take(order, axis=1), row_block[order]

    def sum_products(self) -> JointSums:
        """Return the sums over all blocks."""
        w, x = len(self.have), self.n_columns
        sums = JointSums(np.zeros((w, w)), np.zeros((w, x)), np.zeros(w), np.zeros(x), np.zeros(self.pairs.size))
        for rows in self.read_rows():
            own = (rows.w @ rows.w.T, rows.w @ rows.x.T, rows.w @ rows.y, rows.x @ rows.y)
            for total, part in zip(sums, (*own, self.pairs.compute_products(rows.x)), strict=True):
                total += part
        return sums

    def compute_errors(self, fit: FoldFit) -> RowErrors:
        """Return the squared errors for a fit."""
        return RowErrors(self, fit)


class RowErrors:
    """What `ProductErrors` are, from the rows themselves."""

    def __init__(self, block: RowBlock, fit: FoldFit) -> None:
        self._block, self._chi, self._fit = block, fit.chi[block.have], fit
        self._has = np.flatnonzero(block.place < block.n_columns)

    @cached_property
    def alone(self) -> FloatArray:
        """Squared errors (s,) of the model alone."""
        errors = np.zeros(len(self._block.blocks))
        for rows in self._block.read_rows():
            errors[rows.blocks] = rows.add_up(self._leave_rest(rows) ** 2)
        return errors

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c) by block and column."""
        projection = self._fit.projection[self._block.have]
        scores = np.zeros((len(self._block.blocks), projection.shape[1]))
        for rows in self._block.read_rows():
            rest = self._leave_rest(rows)
            scores[rows.blocks] = -rows.add_up(rows.w * rest).T @ projection
            scores[rows.blocks, self._has] += rows.add_up(rows.x * rest).T
        return scores

    def compute_errors_with(self, amplitudes: Amplitudes) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion."""
        # The model's own parameters are other ones beside a candidate, on the joints that it shares columns with.
        adjustments = amplitudes.model_adjustments[:, self._block.have]
        own = self._block.own.candidates
        is_adjusted = np.asarray(adjustments.any(axis=1))
        is_adjusted[own] = False
        others = np.flatnonzero(is_adjusted)
        errors = np.tile(self.alone, (len(adjustments), 1))
        # What a fold does not determine may be beyond all numbers elsewhere: no gain, whatever it is.
        with np.errstate(over="ignore", invalid="ignore"):
            for rows in self._block.read_rows():
                rest = self._leave_rest(rows)
                # Most candidates have columns of their own on few joints.
                if len(own):
                    residuals = adjustments[own] @ rows.w
                    residuals += rest
                    residuals -= self._block.own.combine(amplitudes, rows.x)
                    errors[own, rows.blocks] = rows.add_up(np.square(residuals, out=residuals))
                if len(others):
                    errors[others, rows.blocks] = self._compute_adjusted_errors(rows, rest, adjustments[others])
        return np.asarray(np.nan_to_num(errors, nan=np.inf))

    def _leave_rest(self, rows: JointRows) -> FloatArray:
        return np.asarray(rows.y - self._chi @ rows.w)

    def _compute_adjusted_errors(self, rows: JointRows, rest: FloatArray, adjustments: FloatArray) -> FloatArray:
        """Return the squared errors (g, s) of the model with adjusted parameters (g, w)."""
        count = rows.blocks.stop - rows.blocks.start
        # Fewer rows than twice the columns of the model are not worth their products.
        if len(rest) < 2 * len(rows.w) * count:
            residuals = adjustments @ rows.w
            residuals += rest
            return rows.add_up(np.square(residuals, out=residuals))
        errors = np.empty((len(adjustments), count))
        edges = np.searchsorted(rows.row_block, np.arange(count + 1))
        for block, (first, last) in enumerate(pairwise(edges)):
            w, own = rows.w[:, first:last], rest[first:last]
            squares = np.einsum("gw,gw->g", adjustments @ (w @ w.T), adjustments)
            squares += 2.0 * (adjustments @ (w @ own)) + own @ own
            np.maximum(squares, 0.0, out=errors[:, block])
        return errors


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

    def hold_rows(self) -> JointBlock:
        """Return the same, with rows that are read once for all uses."""

    def sum_products(self) -> JointSums:
        """Return the sums over all blocks."""

    def compute_errors(self, fit: FoldFit) -> JointErrors:
        """Return the squared errors for a fit."""


@dataclass(frozen=True, eq=False)
class JointBlocks:
    """Rows or products of all joints, for a model and candidates beside it.

    Parameters
    ----------
    base : (b,)
        Columns of the model.
    n_extra : int
        Number of columns c of the candidates.
    n_blocks : int
        Number of blocks.
    portions : tuple of Batch
        The candidates, by number of columns.
    joints : tuple of JointBlock
        Rows or products of each joint.
    known : PriorInformation or None
        What is known of the model's parameters beside the data.
    """

    base: IndexArray
    n_extra: int
    n_blocks: int
    portions: tuple[Batch, ...]
    joints: tuple[JointBlock, ...]
    known: PriorInformation | None

    @classmethod
    def from_products(cls, data: Products, base: IndexArray, candidates: Sequence[Candidate]) -> JointBlocks:
        """Take what is needed to score candidates beside a model."""
        extra = list_extra_columns(candidates)
        portions = split_batches(candidates, extra)
        joints = tuple(_build_block(data, joint, base, extra, portions) for joint in range(data.n_joints))
        return cls(np.asarray(base, dtype=np.intp), len(extra), data.n_blocks, portions, joints, data.known)

    def select_blocks(self, blocks: IndexArray) -> JointBlocks:
        """Return the same for some of the blocks."""
        joints = tuple(joint.select_blocks(blocks) for joint in self.joints)
        return replace(self, n_blocks=len(blocks), joints=joints)

    def fit_model(self, sums: ProductSums) -> FoldFit:
        """Fit the model to the rows of some blocks, given their sums, and to what is known beside them."""
        return FoldFit(sums if self.known is None else sums.add_known(self.known, self.base), self.portions)

    def fit_amplitudes(self, fit: FoldFit) -> Amplitudes:
        """Fit the parameters of each candidate beside the model."""
        each = tuple(fit.fit_amplitudes(number) for number in range(len(self.portions)))
        return Amplitudes(self.portions, each, fit.projection)

    def sum_products(self, noise: FloatArray) -> ProductSums:
        """Return the sums over all blocks and joints, each joint in units of its noise (n,)."""
        b, c = len(self.base), self.n_extra
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
