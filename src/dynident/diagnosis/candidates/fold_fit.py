"""Solve the model, and the model with one candidate more, on all blocks but those of a fold, in batches.

Linear algebra alone: no threshold of the decision is here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from scipy.linalg import cho_factor, cho_solve

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


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """Parameters of the candidates of every portion.

    Parameters
    ----------
    portions : tuple of Batch
        The candidates, by number of columns.
    each : tuple of (g, k)
        Parameters of the candidates of each portion.
    projection : (b, c)
        What the model says of each column of the candidates.
    """

    portions: tuple[Batch, ...]
    each: tuple[FloatArray, ...]
    projection: FloatArray

    @cached_property
    def model_adjustments(self) -> FloatArray:
        """How much smaller the model's own parameters are beside each candidate (g, b), portion by portion."""
        return np.asarray(self._mixing @ self.projection.T)

    @cached_property
    def values(self) -> FloatArray:
        """All parameters (amplitudes,), candidate by candidate and portion by portion."""
        return np.concatenate([own.ravel() for own in self.each])

    @cached_property
    def _mixing(self) -> scipy.sparse.csr_array:
        """Matrix (g, c) that combines all columns into one for each candidate, portion by portion."""
        columns, ends = _list_entries(self.portions)
        return scipy.sparse.csr_array((self.values, columns, ends), shape=(len(ends) - 1, self.projection.shape[1]))


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
    """Sums of products over blocks and joints, in units of the noise.

    Parameters
    ----------
    ww : (b, b)
        WᵀW.
    wx : (b, c)
        WᵀX.
    wy : (b,)
        Wᵀy.
    xy : (c,)
        Xᵀy.
    xx : tuple of (g, k, k)
        XᵀX within candidates, by portion.
    """

    ww: FloatArray
    wx: FloatArray
    wy: FloatArray
    xy: FloatArray
    xx: tuple[FloatArray, ...]

    def add_known(self, known: PriorInformation, base: IndexArray) -> ProductSums:
        """Return the products with what is known of the model's parameters, whose columns are `base` (b,)."""
        squares, right = known.compute_products(base, np.diag(self.ww))
        return replace(self, ww=self.ww + squares, wy=self.wy + right)

    def subtract(self, other: ProductSums) -> ProductSums:
        """Return the products of the rows that are in these sums and not in the others.

        A column that none of these rows has leaves rounding errors alone: it is nothing here, not a small column.
        """
        seen = _is_left(np.diag(self.ww), np.diag(other.ww))
        own = [
            _is_left(np.einsum("gkk->gk", a), np.einsum("gkk->gk", b)) for a, b in zip(self.xx, other.xx, strict=True)
        ]
        return ProductSums(
            (self.ww - other.ww) * (seen[:, None] & seen),
            (self.wx - other.wx) * seen[:, None],
            (self.wy - other.wy) * seen,
            self.xy - other.xy,
            tuple(
                (mine - theirs) * (is_present[:, :, None] & is_present[:, None, :])
                for mine, theirs, is_present in zip(self.xx, other.xx, own, strict=True)
            ),
        )


def _is_left(whole: FloatArray, part: FloatArray) -> BoolArray:
    """Return which columns have any squares left once a part of the rows is taken away."""
    return np.asarray(whole - part > _ROUNDING * whole)


class FoldFit:
    """The model fitted on some blocks, and what is left of every candidate column beside it.

    Parameters
    ----------
    sums : ProductSums
        Products over these blocks.
    portions : sequence of Batch
        The candidates, by number of columns.

    Attributes
    ----------
    chi : (b,)
        Parameters of the model.
    projection : (b, c)
        What the model says of every candidate column.
    portions : tuple of Batch
        The candidates, by number of columns.
    """

    def __init__(self, sums: ProductSums, portions: Sequence[Batch]) -> None:
        self.portions = tuple(portions)
        scale = np.sqrt(np.maximum(np.diag(sums.ww), np.finfo(float).tiny))
        # Columns are scaled to one, since parameters have different units; the small ridge keeps columns that a fold
        # lacks solvable.
        normal = sums.ww / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
        solved = _solve_normal_equations(normal, np.column_stack([sums.wy, sums.wx]) / scale[:, None]) / scale[:, None]
        self.chi, self.projection = solved[:, 0], solved[:, 1:]
        # Products of the candidates' columns with what the model leaves of Y.
        right = sums.xy - sums.wx.T @ self.chi
        self._right, self._rest, self._whole = [], [], []
        for portion, own in zip(portions, sums.xx, strict=True):
            # Frisch, Waugh and Lovell: what the model explains of the candidates' columns is taken out of their
            # products.
            explained = sums.wx.T[portion.columns] @ self.projection.T[portion.columns].transpose(0, 2, 1)
            squares = np.einsum("gkk->gk", own)
            # A column without rows in this fold has no remainder; rounding errors must not make one.
            is_present = squares > 0
            self._rest.append((own - explained) * (is_present[:, :, None] & is_present[:, None, :]))
            self._whole.append(np.maximum(squares, np.finfo(float).tiny))
            self._right.append(right[portion.columns] * is_present)

    def get_remaining_products(self, number: int) -> FloatArray:
        """Return the products (g, k, k) of what the model leaves of the columns of a portion's candidates."""
        return np.asarray(self._rest[number])

    def fit_amplitudes(self, number: int) -> FloatArray:
        """Return the parameters (g, k) of a portion's candidates, each fitted beside the model."""
        scale, normal = self._scale_products(number)
        normal = normal + _OWN_RIDGE * np.eye(normal.shape[2])
        right = self._right[number] / scale
        # One column is a division.
        if normal.shape[2] == 1:
            return np.asarray(right / np.maximum(normal[:, :, 0], np.finfo(float).tiny) / scale)
        inverse = np.linalg.pinv(normal, rcond=_RANK, hermitian=True)
        return np.asarray((inverse @ right[:, :, None])[:, :, 0] / scale)

    def compute_unit_directions(self, number: int) -> FloatArray:
        """Return directions (g, k, k) among a candidate's columns, of which what is left has the norm one."""
        scale, normal = self._scale_products(number)
        values, vectors = np.linalg.eigh(normal)
        # Directions of which nothing is left beside the model get the length zero: they say nothing.
        is_determined = values > np.maximum(_RANK * values[:, -1:], _OWN_RIDGE)
        root = np.where(is_determined, 1.0 / np.sqrt(np.where(is_determined, values, 1.0)), 0.0)
        return np.asarray(vectors * root[:, None, :] / scale[:, :, None])

    def compute_separability(self, number: int) -> FloatArray:
        """Return the share (g,) of a candidate's column that is left beside the model, the largest of its columns."""
        share = np.einsum("gkk->gk", self._rest[number]) / self._whole[number]
        return np.asarray(np.sqrt(np.clip(share, 0.0, 1.0)).max(axis=1))

    def _scale_products(self, number: int) -> tuple[FloatArray, FloatArray]:
        """Return the columns' sizes (g, k), and what is left of their products (g, k, k) in units of these."""
        scale = np.sqrt(self._whole[number])
        return scale, self._rest[number] / (scale[:, :, None] * scale[:, None, :])


def _solve_normal_equations(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solve normal equations (b, b) for (b, k); of all that fit equally well return the smallest solution.

    Without one of the runs, the others may not determine the model: joints that stand still, a single posture.
    """
    try:
        return np.asarray(cho_solve(cho_factor(normal), right))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(normal, rcond=_RANK, hermitian=True) @ right)
