"""Select from all inner products, joint by joint, those that one round of scores needs.

Products of two candidates with each other are never needed, and there are very many of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.fold_fit import Batch, FoldFits, JointSums, OwnColumns
from dynident.diagnosis.candidates.time_blocks_and_folds import (
    BlockSets,
    Products,
    RowRuns,
)


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

    def read_pieces(self) -> Iterator[ProductBlock]:
        """Yield everything at once: it is at hand."""
        yield self

    def sum_sets(self, sets: BlockSets) -> JointSums:
        """Return the sums over sets of blocks."""
        members = sets.members[:, sets.cells]
        ww, wx, wy, xy, yy, *pairs = (
            np.tensordot(members, each, 1) for each in (self.ww, self.wx, self.wy, self.xy, self.yy, *self.pairs)
        )
        of_w = np.concatenate([ww, wy[:, :, None], wx[:, :, :-1]], axis=2)
        of_y = np.concatenate([wy, yy[:, None], xy[:, :-1]], axis=1)[:, None]
        return JointSums(np.concatenate([of_w, of_y], axis=1), tuple(pairs))

    def compute_errors(self, fits: FoldFits, numbers: IndexArray) -> ProductErrors:
        """Return the squared errors for the fit that each block (s,) has, by its number."""
        return ProductErrors(self, fits, numbers)


class ProductErrors:
    """One joint's squared errors in blocks, each for the fit that it has."""

    def __init__(self, block: ProductBlock, fits: FoldFits, numbers: IndexArray) -> None:
        used = np.unique(numbers)
        parts = [np.flatnonzero(numbers == number) for number in used]
        # Where each block stands once those of the same fit follow one another.
        self._places = np.argsort(np.concatenate(parts))
        self._parts = [
            _ErrorsOfOneFit(block.select_blocks(own) if len(used) > 1 else block, fits, number)
            for number, own in zip(used.tolist(), parts, strict=True)
        ]

    @cached_property
    def alone(self) -> FloatArray:
        """Squared errors (s,) of the model alone."""
        return np.concatenate([part.alone for part in self._parts])[self._places]

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c) by block and column."""
        return np.concatenate([part.compute_scores() for part in self._parts])[self._places]

    def compute_errors_with(self) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion."""
        return np.concatenate([part.compute_errors_with() for part in self._parts], axis=1)[:, self._places]

    def compute_squares(self) -> tuple[FloatArray, ...]:
        """Return ZᵀZ (g, s, k, k) of each candidate, portion by portion."""
        each = [part.compute_squares() for part in self._parts]
        return tuple(np.concatenate(portion, axis=1)[:, self._places] for portion in zip(*each, strict=True))


class _ErrorsOfOneFit:
    """One joint's squared errors in blocks, for one fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P. `alone` (s,) are those of the model.
    """

    def __init__(self, block: ProductBlock, fits: FoldFits, number: int) -> None:
        self._block = block
        chi = fits.chi[number, block.have]
        self._projection = fits.projection[number][:, block.have]
        self._amplitudes = [own[number] for own in fits.amplitudes]
        # |y - W χ|² from products alone. It is a small difference of large numbers, which rounding may make negative.
        errors = block.yy - 2 * block.wy @ chi + np.einsum("i,sij,j->s", chi, block.ww, chi)
        self.alone = np.maximum(errors, 0.0)
        # Wᵀρ (s, w) and Xᵀρ (s, x + 1) of what the model leaves.
        self._w_rest = block.wy - block.ww @ chi
        self._x_rest = block.xy - chi @ block.wx

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c) by block and column."""
        return np.asarray(self._x_rest[:, self._block.place] - self._w_rest @ self._projection.T)

    def compute_errors_with(self) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion."""
        each = zip(self._block.portions, self._block.pairs, self._amplitudes, strict=True)
        return np.concatenate([self._compute_portion_errors(*own) for own in each])

    def _compute_portion_errors(self, portion: Batch, pairs: FloatArray, amplitudes: FloatArray) -> FloatArray:
        """Return the squared errors (g, s) with each candidate of a portion."""
        block = self._block
        shift = np.einsum("gkb,gk->bg", self._projection[portion.columns], amplitudes)
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

    def compute_squares(self) -> tuple[FloatArray, ...]:
        """Return ZᵀZ (g, s, k, k) of each candidate, portion by portion."""
        block, products = self._block, []
        for portion, pairs in zip(block.portions, block.pairs, strict=True):
            own = pairs.transpose(1, 0, 2, 3).copy()
            # Column by column, as in the errors: sums over the model's columns of all candidates are one product each.
            shifts = [self._projection[portion.columns[:, k]].T for k in range(portion.width)]
            for k, shift in enumerate(shifts):
                mixed = block.wx[:, :, block.place[portion.columns[:, k]]]
                # Wᵀ Z of this column.
                rest = mixed - block.ww @ shift
                for other, its_shift in enumerate(shifts):
                    own[:, :, k, other] -= np.einsum("sbg,bg->gs", mixed, its_shift)
                    own[:, :, other, k] -= np.einsum("sbg,bg->gs", rest, its_shift)
            products.append(own)
        return tuple(products)


# Numbers of a joint's rows that are read at once: fewer take more calls, more leave the cache.
_MOST_VALUES = 2**19


@dataclass(frozen=True, eq=False)
class RowBlock:
    """Which rows and columns of one joint a score takes; they are read when they are needed.

    Parameters
    ----------
    data : Products
        Rows of all joints.
    joint : int
        Number of the joint.
    have : (w,)
        Columns of the model that the joint has.
    place : (c,)
        Where each column of the candidates stands among the x that the joint has, x for those that it lacks.
    needed : (w + 1 + x,)
        Where the columns of the model, Y, and the columns of the candidates stand in the rows.
    portions : tuple of Batch
        The candidates, by number of columns.
    own : OwnColumns
        Candidates that have columns of their own on the joint.
    """

    data: Products
    joint: int
    have: IndexArray
    place: IndexArray
    needed: IndexArray
    portions: tuple[Batch, ...]
    own: OwnColumns

    @classmethod
    def from_products(
        cls, data: Products, joint: int, base: IndexArray, extra: IndexArray, portions: Sequence[Batch]
    ) -> RowBlock:
        """Take what is needed out of a joint's rows."""
        have, wp = find_present(data.position[joint], base)
        place, xp = locate_columns(data.position[joint], extra)
        own = OwnColumns.from_places(place, len(xp), portions)
        # Y stands last.
        y = int((data.position[joint] >= 0).sum())
        return cls(data, joint, have, place, np.concatenate([wp, [y], xp]), tuple(portions), own)

    @property
    def n_columns(self) -> int:
        """Number of columns x of the candidates that the joint has."""
        return len(self.needed) - len(self.have) - 1

    def read_pieces(self) -> Iterator[RowPiece]:
        """Yield the rows, kind by kind, some blocks at a time."""
        for stack in self.data.list_row_stacks(self.joint):
            for rows, runs in stack.split_pieces(max(1, _MOST_VALUES // len(self.needed))):
                yield RowPiece(self, stack.read_columns(self.needed, rows), runs)

    def sum_sets(self, sets: BlockSets) -> JointSums:
        """Return the sums over sets of blocks."""
        left = self.needed[: len(self.have) + 1]
        products = self.data.sum_sets(self.joint, sets, left, self.needed)
        return JointSums(products, self._sum_pairs(sets))

    def _sum_pairs(self, sets: BlockSets) -> tuple[FloatArray, ...]:
        """Return XᵀX (f, g, k, k) within the candidates of each portion."""
        places = [self.place[portion.columns] for portion in self.portions]
        present = [own < self.n_columns for own in places]
        # All portions at once: what a joint has of them is often little.
        entries = [np.nonzero(has[:, :, None] & has[:, None, :]) for has in present]
        pairs = [
            np.stack([own[member, k], own[member, other]])
            for own, (member, k, other) in zip(places, entries, strict=True)
        ]
        of_x = self.needed[len(self.have) + 1 :]
        firsts, seconds = of_x[np.concatenate([np.zeros((2, 0), dtype=np.intp), *pairs], axis=1)]
        sums = self.data.sum_pairs(self.joint, sets, firsts, seconds)
        each, first = [], 0
        for own, (member, k, other) in zip(places, entries, strict=True):
            squares = np.zeros((len(sets.members), *own.shape, own.shape[1]))
            squares[:, member, k, other] = sums[:, first : first + len(member)]
            each.append(squares)
            first += len(member)
        return tuple(each)


@dataclass(frozen=True, eq=False)
class RowPiece:
    """Rows of one joint, column by column, since a score takes some columns of all rows.

    Parameters
    ----------
    block : RowBlock
        Which columns these are.
    columns : (w + 1 + x, m)
        W of the model, Y, and X of the candidates.
    runs : RowRuns
        The block of each row.
    """

    block: RowBlock
    columns: FloatArray
    runs: RowRuns

    @property
    def w(self) -> FloatArray:
        """Columns (w, m) of the model."""
        return self.columns[: len(self.block.have)]

    @property
    def y(self) -> FloatArray:
        """The torque Y (m,)."""
        return np.asarray(self.columns[len(self.block.have)])

    @property
    def x(self) -> FloatArray:
        """Columns (x, m) of the candidates."""
        return self.columns[len(self.block.have) + 1 :]

    def compute_errors(self, fits: FoldFits, numbers: IndexArray) -> RowErrors:
        """Return the squared errors for the fit that each block (s,) has, by its number."""
        return RowErrors(self, fits, numbers)


class RowErrors:
    """What `ProductErrors` are, from the rows themselves; zero in blocks that have none here."""

    def __init__(self, piece: RowPiece, fits: FoldFits, numbers: IndexArray) -> None:
        self._piece, self._fits, self._numbers, self._have = piece, fits, numbers, piece.block.have
        # Rows that follow one another and have the same fit.
        self._spans = piece.runs.split_rows(numbers)
        self._used = slice(int(numbers.min()), int(numbers.max()) + 1)
        self._rest, chi, w = piece.y.copy(), fits.chi[:, self._have], piece.w
        for number, rows in self._spans:
            self._rest[rows] -= chi[number] @ w[:, rows]

    @cached_property
    def alone(self) -> FloatArray:
        """Squared errors (s,) of the model alone."""
        return self._piece.runs.sum_by_block(self._rest**2)

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c) by block and column."""
        piece, scores = self._piece, np.zeros((self._piece.runs.n_blocks, len(self._piece.block.place)))
        of_w, of_x = (piece.runs.sum_by_block(each * self._rest).T for each in (piece.w, piece.x))
        for number in np.unique(self._numbers):
            blocks = np.flatnonzero(self._numbers == number)
            scores[blocks] = -of_w[blocks] @ self._fits.projection[number][:, self._have].T
        has = np.flatnonzero(piece.block.place < piece.block.n_columns)
        scores[:, has] += of_x
        return scores

    def compute_errors_with(self) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion."""
        # The model's own parameters are other ones beside a candidate, on the joints that it shares columns with.
        adjustments = self._fits.model_adjustments[self._used][:, :, self._have]
        errors = np.tile(self.alone, (adjustments.shape[1], 1))
        # A joint that stands has no rows.
        if not self._spans:
            return errors
        # Most candidates have columns of their own on few joints, and change nothing on others.
        is_changed = np.asarray(adjustments.any(axis=(0, 2)))
        is_changed[self._piece.block.own.candidates] = True
        changed = np.flatnonzero(is_changed)
        # What a fold does not determine may be beyond all numbers elsewhere: no gain, whatever it is.
        with np.errstate(over="ignore", invalid="ignore"):
            rest = self._leave_rest(changed, adjustments[:, changed])
            errors[changed] = self._piece.runs.sum_by_block(np.square(rest, out=rest))
        errors[np.isnan(errors)] = np.inf
        return errors

    def _leave_rest(self, candidates: IndexArray, adjustments: FloatArray) -> FloatArray:
        """Return what the model leaves of Y (r, m) with each of some candidates; adjustments (f, r, w) of used fits."""
        piece, w, rest = self._piece, self._piece.w, np.empty((len(candidates), len(self._rest)))
        for number, rows in self._spans:
            np.matmul(adjustments[number - self._used.start], w[:, rows], out=rest[:, rows])
        rest += self._rest
        numbers = [number for number, _ in self._spans]
        lengths = [rows.stop - rows.start for _, rows in self._spans]
        own = np.searchsorted(candidates, piece.block.own.candidates)
        for members, places, columns in piece.block.own.layers:
            factors = self._fits.values[numbers][:, places].T
            rest[own[members]] -= np.repeat(factors, lengths, axis=1) * piece.x[columns]
        return rest

    def compute_squares(self) -> tuple[FloatArray, ...]:
        """Return ZᵀZ (g, s, k, k) of each candidate, portion by portion."""
        piece, portions = self._piece, self._fits.portions
        has = np.flatnonzero(piece.block.place < piece.block.n_columns)
        projections = self._fits.projection[self._used][:, :, self._have]
        # Nothing is left of columns that neither the joint nor the model's parameters on it have a share in.
        is_shared = np.asarray(projections.any(axis=(0, 2)))
        is_shared[has] = True
        shared = np.flatnonzero(is_shared)
        projections, rest = projections[:, shared], np.zeros((len(is_shared), len(self._rest)))
        for number, rows in self._spans:
            rest[shared, rows] = -(projections[number - self._used.start] @ piece.w[:, rows])
        rest[has] += piece.x[piece.block.place[has]]
        products = [np.zeros((len(own.members), piece.runs.n_blocks, own.width, own.width)) for own in portions]
        for portion, own_products in zip(portions, products, strict=True):
            members = np.flatnonzero(is_shared[portion.columns].any(axis=1))
            own = rest[portion.columns[members]]
            squares = piece.runs.sum_by_block(own[:, :, None, :] * own[:, None, :, :])
            own_products[members] = squares.transpose(0, 3, 1, 2)
        return tuple(products)


class JointErrors(Protocol):
    """One joint's squared errors in blocks, each for the fit that it has."""

    @property
    def alone(self) -> FloatArray:
        """Squared errors (s,) of the model alone."""

    def compute_scores(self) -> FloatArray:
        """Return the scores Zᵀρ (s, c): Z is what the model leaves of each candidate's column, ρ the same of Y."""

    def compute_errors_with(self) -> FloatArray:
        """Return the squared errors (g, s) with each candidate, portion by portion, for the amplitudes of its fit."""

    def compute_squares(self) -> tuple[FloatArray, ...]:
        """Return ZᵀZ (g, s, k, k) of each candidate, portion by portion."""


class JointPiece(Protocol):
    """Rows or products of one joint."""

    def compute_errors(self, fits: FoldFits, numbers: IndexArray) -> JointErrors:
        """Return the squared errors for the fit that each block (s,) has, by its number."""


class JointBlock(Protocol):
    """One joint's share: which of the model's columns it has, `have` (w,), and where those of candidates are."""

    @property
    def have(self) -> IndexArray:
        """(w,): which of the model's columns the joint has."""

    @property
    def place(self) -> IndexArray:
        """(c,): where each of the candidates' columns stands among the x that the joint has, x where it lacks it."""

    def read_pieces(self) -> Iterator[JointPiece]:
        """Yield rows or products piece by piece: their errors add up."""

    def sum_sets(self, sets: BlockSets) -> JointSums:
        """Return the sums over sets of blocks."""


def locate_columns(where: IndexArray, columns: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return where columns stand among those that a joint has.

    Returns
    -------
    tuple of (c,), (x,)
        Number of each column among the x that the joint has, x where it lacks it; and the places of these x.
    """
    have, places = find_present(where, columns)
    place = np.full(len(columns), len(have), dtype=np.intp)
    place[have] = np.arange(len(have))
    return place, places


def find_present(where: IndexArray, columns: IndexArray) -> tuple[IndexArray, IndexArray]:
    """Return which of `columns` (c,) a joint has, and where in its products they stand."""
    # An empty list of columns makes an array of floats, which is no index.
    places = where[columns] if len(columns) else np.zeros(0, dtype=np.intp)
    have = np.flatnonzero(places >= 0)
    return have, places[have]
