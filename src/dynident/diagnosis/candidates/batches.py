"""Candidates with equally many columns, scored together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.pool import Candidate

# Candidates at once: what their projections take of memory stays in the cache.
_CHUNK = 128

# So few are asked more quickly as a full matrix than as a sparse one.
_FEW = 8


@dataclass(frozen=True, eq=False)
class Batch:
    """Candidates with k columns each: their numbers (g,), and their columns (g, k) among the `extra` ones."""

    members: IndexArray
    columns: IndexArray

    @property
    def width(self) -> int:
        """Number of columns k."""
        return int(self.columns.shape[1])


def list_extra_columns(candidates: Sequence[Candidate]) -> IndexArray:
    """(c,): all columns of the candidates, ascending."""
    return np.array(sorted({k for candidate in candidates for k in candidate.columns}), dtype=np.intp)


def split_batches(candidates: Sequence[Candidate], extra: IndexArray) -> tuple[Batch, ...]:
    """The candidates by their number of columns, in handy portions."""
    portions: list[Batch] = []
    for width in sorted({len(candidate.columns) for candidate in candidates}):
        members = np.array([i for i, c in enumerate(candidates) if len(c.columns) == width], dtype=np.intp)
        columns = np.searchsorted(extra, np.array([candidates[i].columns for i in members], dtype=np.intp))
        starts = range(0, len(members), _CHUNK)
        portions += [Batch(members[k : k + _CHUNK], columns[k : k + _CHUNK].reshape(-1, width)) for k in starts]
    return tuple(portions)


def split_by_portion(values: FloatArray, portions: Sequence[Batch]) -> tuple[FloatArray, ...]:
    """(g, k, k) of every portion, from those of all in a row."""
    sizes = [portion.columns.size * portion.width for portion in portions]
    parts = np.split(values, np.cumsum(sizes)[:-1]) if sizes else []
    return tuple(part.reshape(-1, portion.width, portion.width) for part, portion in zip(parts, portions, strict=True))


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """Parameters of the candidates of every portion, (g, k) each, among as many columns as `projection` (b, c) has.

    `projection`: what the model says of each of these columns.
    """

    portions: tuple[Batch, ...]
    each: tuple[FloatArray, ...]
    projection: FloatArray

    @cached_property
    def model_adjustments(self) -> FloatArray:
        """(g, b): by how much the model's own parameters are smaller beside each candidate, portion by portion."""
        return np.asarray(self._mixing @ self.projection.T)

    def select_own_columns(self, columns: IndexArray) -> tuple[IndexArray, FloatArray | sparse.csr_array]:
        """(r,): candidates that have any of some `columns` (x,), by number; (r, x): makes of these one for each."""
        if self._mixing.shape[0] <= _FEW:
            return np.arange(self._mixing.shape[0]), self._dense[:, columns]
        selected = self._mixing[:, columns]
        rows = np.flatnonzero(np.diff(selected.indptr))
        return rows, selected[rows]

    @cached_property
    def _dense(self) -> FloatArray:
        return np.asarray(self._mixing.toarray())

    @cached_property
    def _mixing(self) -> sparse.csr_array:
        """(g, c): makes of all columns one for every candidate, portion by portion."""
        widths = np.concatenate([np.full(len(own), own.shape[1]) for own in self.each])
        values = np.concatenate([own.ravel() for own in self.each])
        columns = np.concatenate([portion.columns.ravel() for portion in self.portions])
        ends = np.concatenate([[0], np.cumsum(widths)])
        return sparse.csr_array((values, columns, ends), shape=(len(widths), self.projection.shape[1]))
