"""QR decomposition: triangular factors that stand for any number of rows."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack

from dynident.arrays import FloatArray

_BLOCK = 32
"""Columns that LAPACK processes at once; its workspace is this many times the number of columns."""


def compute_r_factor(rows: FloatArray) -> FloatArray:
    """Return the factor R (…, k, k) of the QR decomposition of rows (…, m, k); (…, m, k) where there are fewer rows."""
    if rows.ndim > 2 or not rows.size:
        return np.asarray(np.linalg.qr(rows, mode="r"))
    # By SciPy: numpy keeps Python's lock all the while, and other threads would wait.
    k = rows.shape[1]
    return np.triu(lapack.dgeqrf(rows, lwork=_BLOCK * k)[0][:k])


def join_factors(factors: FloatArray) -> FloatArray:
    """Return the factor (k, k) of the rows of all factors (s, k, k) together."""
    k = factors.shape[-1]
    if not len(factors):
        return np.zeros((k, k))
    return pad_to_square(compute_r_factor(factors.reshape(-1, k)))


def pad_to_square(r: FloatArray) -> FloatArray:
    """Return a factor (…, m, k) padded with zero rows to (…, k, k) where it has fewer rows than columns."""
    missing = r.shape[-1] - r.shape[-2]
    if missing <= 0:
        return r
    padding = [(0, 0)] * (r.ndim - 2) + [(0, missing), (0, 0)]
    return np.pad(r, padding)
