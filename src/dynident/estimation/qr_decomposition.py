"""Compute, join and pad triangular factors (QR), and whiten columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import lapack

from dynident.array_types import BoolArray, FloatArray

# Singular values below this share of the largest count as directions that no row excites.
_SEEN = 1e-9
# Reciprocal condition number above which a triangular factor is inverted as it is.
_REGULAR = 1e-6


@dataclass(frozen=True, eq=False)
class WhitenedColumns:
    """Columns of s blocks whose inner products over all blocks are those of unit vectors at right angles.

    They are combinations of the columns that they were made of; directions that no block excites are left out.

    Parameters
    ----------
    rows : (s, m, p)
        The columns Wₛ of every block, with Σ WₛᵀWₛ = 1.
    coordinates : (p, k)
        Inner products of these columns with those that parameters belong to.
    """

    rows: FloatArray
    coordinates: FloatArray

    @property
    def count(self) -> int:
        """Number of directions p."""
        return int(self.rows.shape[2])

    @property
    def grams(self) -> FloatArray:
        """WₛᵀWₛ (s, p, p) of every block; of many joints they are too large to be kept."""
        return np.asarray(self.rows.transpose(0, 2, 1) @ self.rows)

    @property
    def squares(self) -> FloatArray:
        """Σ (WₛᵀWₛ)² (p, p); its trace is at most p: the larger, the fewer blocks hold the information."""
        return self.sum_products[0]

    @cached_property
    def sum_products(self) -> tuple[FloatArray, FloatArray]:
        """Σ of the products of WₛᵀWₛ with itself, and with that of the next block, (p, p) each."""
        grams = self.grams
        flat, following = grams.reshape(-1, self.count), grams[1:].reshape(-1, self.count)
        return flat.T @ flat, flat[: len(following)].T @ following

    def express_fit(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance (p, p) of what a fit takes out, given that of its parameters (k, k)."""
        return np.asarray(self.coordinates @ covariance @ self.coordinates.T)

    def compute_scores(self, rests: FloatArray) -> FloatArray:
        """Return Wₛᵀρₛ of every block (s, p) for residuals (s, m)."""
        return np.asarray((rests[:, None, :] @ self.rows)[:, 0])


def whiten_columns(w: FloatArray, factor: FloatArray, observed: FloatArray | None = None) -> WhitenedColumns | None:
    """Whiten columns by the triangular factor of all of them.

    Parameters
    ----------
    w : (s, m, k)
        Columns of s blocks.
    factor : (…, k)
        Upper triangular factor of the rows of all blocks.
    observed : (s, m, k), optional
        Columns that parameters belong to, where these are instruments for them.

    Returns
    -------
    WhitenedColumns or None
        None where all columns are zero.
    """
    k = factor.shape[1]
    if not k:
        return None
    if len(factor) >= k and lapack.dtrcon(factor[:k])[0] > _REGULAR:
        rows, coordinates = w @ lapack.dtrtri(factor[:k])[0], factor[:k]
    else:
        _, singular, vt = np.linalg.svd(factor, full_matrices=False)
        is_excited = singular > _SEEN * singular[0] if singular[0] > 0 else np.zeros(len(singular), dtype=bool)
        if not is_excited.any():
            return None
        # With R = U S Vᵀ the columns W V S⁻¹ have unit inner products: whitening by the SVD copes with singular R.
        coordinates = vt[is_excited] * singular[is_excited][:, None]
        rows = w @ (vt[is_excited].T / singular[is_excited])
    if observed is not None:
        coordinates = np.tensordot(rows, observed, axes=([0, 1], [0, 1]))
    return WhitenedColumns(rows, coordinates)


_BLOCK = 32
"""Columns that LAPACK processes at once; its workspace is this many times the number of columns."""
_RECURSIVE_BLOCK, _RECURSIVE_FROM = 16, 8000
"""The same of the recursive algorithm (Elmroth and Gustavson 2000), and from how many numbers on it is used: for 200
to 2,000 rows of 30 to 120 columns it takes 0.5 to 0.9 of the time, for fewer numbers up to twice as long."""


def compute_r_factor(rows: FloatArray) -> FloatArray:
    """Return the factor R (…, k, k) of the QR decomposition of rows (…, m, k); (…, m, k) where there are fewer rows."""
    # Most groups of rows, such as those at reversals, are empty in most blocks.
    if not rows.size:
        return np.zeros((*rows.shape[:-2], min(rows.shape[-2:]), rows.shape[-1]))
    if rows.ndim > 2:
        return np.asarray(np.linalg.qr(rows, mode="r"))
    # By SciPy: numpy keeps Python's lock all the while, and other threads would wait.
    k = rows.shape[1]
    if rows.size >= _RECURSIVE_FROM and min(rows.shape) >= _RECURSIVE_BLOCK:
        factor = lapack.dgeqrt(_RECURSIVE_BLOCK, rows)[0][:k]
    else:
        factor = lapack.dgeqrf(rows, lwork=_BLOCK * k)[0][:k]
    # LAPACK leaves the reflectors below the diagonal. They would give Q, which nobody needs.
    return np.where(_mask_below_diagonal(factor.shape), 0.0, factor)


@lru_cache(maxsize=512)
def _mask_below_diagonal(shape: tuple[int, int]) -> BoolArray:
    """Return True below the diagonal. Thousands of small factors have few shapes: a mask for each takes a third."""
    return np.tri(*shape, k=-1, dtype=bool)


def join_factors(factors: FloatArray) -> FloatArray:
    """Return the factor (k, k) of the rows of all factors (s, m, k) together."""
    k = factors.shape[-1]
    if not len(factors):
        return np.zeros((k, k))
    rows = factors.reshape(-1, k)
    # Blocks with few rows are padded with zeros.
    return pad_to_square(compute_r_factor(rows[rows.any(axis=1)]))


def add_rows_to_factors(factors: FloatArray, rows: FloatArray) -> FloatArray:
    """Return the factors (s, m, p + 1) of blocks with further rows (s, k, p + 1), which are zero in many blocks."""
    has = rows.any(axis=(1, 2))
    if not has.any():
        return factors
    changed = compute_r_factor(np.concatenate([factors[has], rows[has]], axis=1))
    joined = np.zeros((len(factors), max(factors.shape[1], changed.shape[1]), factors.shape[2]))
    joined[~has, : factors.shape[1]] = factors[~has]
    joined[has, : changed.shape[1]] = changed
    return joined


def pad_to_square(r: FloatArray) -> FloatArray:
    """Return a factor (…, m, k) padded with zero rows to (…, k, k) where it has fewer rows than columns."""
    missing = r.shape[-1] - r.shape[-2]
    if missing <= 0:
        return r
    return np.concatenate([r, np.zeros((*r.shape[:-2], missing, r.shape[-1]))], axis=-2)


def stack_blocks(blocks: Sequence[FloatArray], width: int) -> FloatArray:
    """Return blocks of rows of k columns as one array (s, m, k): the most rows of any, zeros where others have fewer.

    A robot of many joints has far more columns than a block has rows: square factors would be nearly all zeros.
    """
    stacked = np.zeros((len(blocks), max(map(len, blocks), default=0), width))
    for place, rows in zip(stacked, blocks, strict=True):
        place[: len(rows)] = rows
    return stacked


def concatenate_stacks(stacks: Sequence[FloatArray]) -> FloatArray:
    """Return all blocks of stacks (s, m, k), which may differ in s and m, as one stack."""
    return stack_blocks([rows for stack in stacks for rows in stack], stacks[0].shape[2])
