"""Solve the model, and the model with one candidate more, on all blocks but those of a fold, in batches.

Linear algebra alone: no threshold of the decision is here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.estimation import PriorInformation

# Candidates at once: what their projections take of memory stays in the cache.
_CHUNK = 128


@dataclass(frozen=True, eq=False)
class Batch:
    """Candidates with equally many columns, k each.

    Parameters
    ----------
    members : (g,)
        Numbers of the candidates.
    columns : (g, k)
        Their columns among the extra ones.
    """

    members: IndexArray
    columns: IndexArray

    @property
    def width(self) -> int:
        """Number of columns k."""
        return int(self.columns.shape[1])


def list_extra_columns(candidates: Sequence[Candidate]) -> IndexArray:
    """Return all columns (c,) of the candidates, ascending."""
    return np.array(sorted({k for candidate in candidates for k in candidate.columns}), dtype=np.intp)


def split_batches(candidates: Sequence[Candidate], extra: IndexArray) -> tuple[Batch, ...]:
    """Split the candidates by their number of columns into portions of limited size."""
    portions: list[Batch] = []
    for width in sorted({len(candidate.columns) for candidate in candidates}):
        members = np.array([i for i, c in enumerate(candidates) if len(c.columns) == width], dtype=np.intp)
        # `extra` is ascending, so that the place of a column in it is found by bisection.
        columns = np.searchsorted(extra, np.array([candidates[i].columns for i in members], dtype=np.intp))
        starts = range(0, len(members), _CHUNK)
        portions += [Batch(members[k : k + _CHUNK], columns[k : k + _CHUNK].reshape(-1, width)) for k in starts]
    return tuple(portions)


def _list_entries(portions: Sequence[Batch]) -> tuple[IndexArray, IndexArray]:
    """Return the columns (amplitudes,) of all portions in a row, and where those of each candidate end (g + 1,)."""
    nothing = np.zeros(0, dtype=np.intp)
    columns = np.concatenate([nothing, *(portion.columns.ravel() for portion in portions)])
    widths = np.concatenate([nothing, *(np.full(len(portion.members), portion.width) for portion in portions)])
    return columns, np.concatenate([[0], np.cumsum(widths)]).astype(np.intp)


@dataclass(frozen=True, eq=False)
class OwnColumns:
    """Which candidates have any of the x columns of a joint, and which of their amplitudes are those of these columns.

    It is the same in every fold, in which only the amplitudes are other ones.

    Parameters
    ----------
    candidates : (r,)
        Numbers of the candidates.
    layers : tuple of ((l,), (l,), (l,))
        The first columns of all candidates, the second ones of those that have two, and so on: places of the candidates
        among these r, numbers of the amplitudes, and columns among the x.
    """

    candidates: IndexArray
    layers: tuple[tuple[IndexArray, IndexArray, IndexArray], ...]

    @classmethod
    def from_places(cls, place: IndexArray, count: int, portions: Sequence[Batch]) -> OwnColumns:
        """Find them for one joint."""
        columns, ends = _list_entries(portions)
        amplitudes = np.flatnonzero(place[columns] < count)
        owner = np.searchsorted(ends, amplitudes, side="right") - 1
        candidates, firsts, owner = np.unique(owner, return_index=True, return_inverse=True)
        rank = np.arange(len(owner)) - firsts[owner]
        layers = [np.flatnonzero(rank == k) for k in range(int(rank.max(initial=-1)) + 1)]
        return cls(candidates, tuple((owner[k], amplitudes[k], place[columns[amplitudes[k]]]) for k in layers))


# Ridge on the model's equations with unit columns, on those of a candidate, and share of the largest eigenvalue below
# which a direction is not determined.
_RIDGE = 1e-10
_OWN_RIDGE, _RANK = 1e-9, 1e-8
_TINY = float(np.finfo(float).tiny)
_ROUNDING = 1e-12
"""Share of a sum below which a difference of two sums is what rounding leaves: thousands of terms of 1e-16 each."""


class JointSums(NamedTuple):
    """Sums of one joint over f sets of blocks, of the w columns of the model and the x of the candidates that it has.

    Parameters
    ----------
    products : (f, w + 1, w + 1 + x)
        Products of W and Y with W, Y and X.
    xx : tuple of (f, g, k, k)
        XᵀX within candidates, by portion.
    """

    products: FloatArray
    xx: tuple[FloatArray, ...]


@dataclass(frozen=True, eq=False)
class ProductSums:
    """Sums of products over f sets of blocks and all joints, in units of the noise; the first set is all blocks.

    Parameters
    ----------
    ww : (f, b, b)
        WᵀW.
    xw : (f, c, b)
        XᵀW.
    wy : (f, b)
        Wᵀy.
    xy : (f, c)
        Xᵀy.
    xx : tuple of (f, g, k, k)
        XᵀX within candidates, by portion.
    """

    ww: FloatArray
    xw: FloatArray
    wy: FloatArray
    xy: FloatArray
    xx: tuple[FloatArray, ...]

    def add_known(self, known: PriorInformation, base: IndexArray) -> ProductSums:
        """Return the products with what is known of the model's parameters, whose columns are `base` (b,)."""
        each = [known.compute_products(base, np.diag(own)) for own in self.ww]
        squares, right = (np.array(own) for own in zip(*each, strict=True))
        return replace(self, ww=self.ww + squares, wy=self.wy + right)

    def leave_out(self, sets: IndexArray) -> ProductSums:
        """Return the products of all blocks but those of each of some sets; of the first set nothing is left out.

        A column that none of the remaining rows has leaves rounding errors alone: it is nothing, not a small column.
        """

        def subtract(sums: FloatArray) -> FloatArray:
            part = sums[sets]
            part[sets == 0] = 0.0
            return np.asarray(sums[0] - part)

        def is_left(squares: FloatArray) -> BoolArray:
            return np.asarray(subtract(squares) > _ROUNDING * squares[0])

        seen, own = is_left(_take_diagonals(self.ww)), [is_left(_take_diagonals(each)) for each in self.xx]
        return ProductSums(
            subtract(self.ww) * _pair(seen),
            subtract(self.xw) * seen[:, None],
            subtract(self.wy) * seen,
            subtract(self.xy),
            tuple(subtract(each) * _pair(is_present) for each, is_present in zip(self.xx, own, strict=True)),
        )


def _take_diagonals(matrices: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...kk->...k", matrices))


def _pair(values: FloatArray | BoolArray) -> FloatArray:
    """Return the products (..., k, k) of all pairs of some values (..., k)."""
    return np.multiply(values[..., :, None], values[..., None, :], dtype=np.float64)


class FoldFits:
    """The model fitted on f sets of blocks, and what is left of every candidate column beside each of these fits.

    Parameters
    ----------
    sums : ProductSums
        Products over these blocks.
    portions : sequence of Batch
        The candidates, by number of columns.

    Attributes
    ----------
    chi : (f, b)
        Parameters of the model.
    projection : (f, c, b)
        What the model says of every candidate column.
    portions : tuple of Batch
        The candidates, by number of columns.
    """

    def __init__(self, sums: ProductSums, portions: Sequence[Batch]) -> None:
        self.portions = tuple(portions)
        scale = np.sqrt(np.maximum(_take_diagonals(sums.ww), _TINY))
        # Columns are scaled to one, since parameters have different units; the small ridge keeps columns that a fold
        # lacks solvable.
        normal = sums.ww / _pair(scale) + _RIDGE * np.eye(scale.shape[1])
        solved = np.concatenate([sums.wy[:, None], sums.xw], axis=1) / scale[:, None]
        for each, own in zip(normal, solved, strict=True):
            _solve_normal_equations(each, own)
        solved /= scale[:, None]
        self.chi, self.projection = solved[:, 0], solved[:, 1:]
        # Products of the candidates' columns with what the model leaves of Y.
        right = sums.xy - (sums.xw @ self.chi[:, :, None])[:, :, 0]
        self._right, self._rest, self._whole = [], [], []
        for portion, own in zip(portions, sums.xx, strict=True):
            # Frisch, Waugh and Lovell: what the model explains of the candidates' columns is taken out of their
            # products.
            columns = portion.columns
            explained = sums.xw[:, columns] @ self.projection[:, columns].transpose(0, 1, 3, 2)
            squares = _take_diagonals(own)
            # A column without rows in this fold has no remainder; rounding errors must not make one.
            is_present = squares > 0
            self._rest.append((own - explained) * _pair(is_present))
            self._whole.append(np.maximum(squares, _TINY))
            self._right.append(right[:, columns] * is_present)

    def get_remaining_products(self, number: int) -> FloatArray:
        """Return the products (f, g, k, k) of what the model leaves of the columns of a portion's candidates."""
        return np.asarray(self._rest[number])

    @cached_property
    def amplitudes(self) -> tuple[FloatArray, ...]:
        """Parameters (f, g, k) of each portion's candidates, each fitted beside the model."""
        return tuple(self._fit_amplitudes(number) for number in range(len(self.portions)))

    @cached_property
    def values(self) -> FloatArray:
        """All amplitudes (f, amplitudes), candidate by candidate and portion by portion."""
        return np.concatenate([own.reshape(len(own), -1) for own in self.amplitudes], axis=1)

    @cached_property
    def model_adjustments(self) -> FloatArray:
        """How much smaller the model's own parameters are beside each candidate (f, g, b), portion by portion."""
        each = [
            (own[:, :, None] @ self.projection[:, portion.columns])[:, :, 0]
            for portion, own in zip(self.portions, self.amplitudes, strict=True)
        ]
        return np.concatenate(each, axis=1)

    def _fit_amplitudes(self, number: int) -> FloatArray:
        scale, normal = self._scale_products(number)
        normal = normal + _OWN_RIDGE * np.eye(normal.shape[-1])
        right = self._right[number] / scale
        # One column is a division.
        if normal.shape[-1] == 1:
            return np.asarray(right / np.maximum(normal[..., 0], _TINY) / scale)
        inverse = np.linalg.pinv(normal, rcond=_RANK, hermitian=True)
        return np.asarray((inverse @ right[..., None])[..., 0] / scale)

    def compute_unit_directions(self, number: int) -> FloatArray:
        """Return directions (g, k, k) among a candidate's columns, of which the first fit leaves the norm one."""
        scale, normal = (own[0] for own in self._scale_products(number))
        values, vectors = np.linalg.eigh(normal)
        # Directions of which nothing is left beside the model get the length zero: they say nothing.
        is_determined = values > np.maximum(_RANK * values[:, -1:], _OWN_RIDGE)
        root = np.where(is_determined, 1.0 / np.sqrt(np.where(is_determined, values, 1.0)), 0.0)
        return np.asarray(vectors * root[:, None, :] / scale[:, :, None])

    def compute_separability(self, number: int) -> FloatArray:
        """Return the share (g,) of a candidate's column that the first fit leaves, the largest of its columns."""
        share = _take_diagonals(self._rest[number][0]) / self._whole[number][0]
        return np.asarray(np.sqrt(np.clip(share, 0.0, 1.0)).max(axis=1))

    def _scale_products(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return the columns' sizes (f, g, k), and what is left of their products (f, g, k, k) in units of these."""
        scale = np.sqrt(self._whole[number])
        return scale, self._rest[number] / _pair(scale)


def _solve_normal_equations(normal: FloatArray, right: FloatArray) -> None:
    """Replace the right sides (k, b) of normal equations (b, b) by the solutions, of many the smallest.

    Without one of the runs, the others may not determine the model: joints that stand still, a single posture.
    """
    # The transposes are as LAPACK wants them, so that nothing is copied.
    factor, info = lapack.dpotrf(normal.T)
    if info:
        right[:] = right @ np.linalg.pinv(normal, rcond=_RANK, hermitian=True)
    else:
        right[:] = lapack.dpotrs(factor, right.T, overwrite_b=True)[0].T
