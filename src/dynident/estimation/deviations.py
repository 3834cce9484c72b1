"""Standard deviations where rows may leave parameters open, and what they owe to knowledge beside the data."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray
from dynident.estimation.factors import Reduction
from dynident.estimation.least_squares import Solution, doubtful_noise, weighted_factor

_NULL, _LOOSE = 1e-9, 1e-5
# More than so many times as sure as by the data alone: three quarters of what is known come from elsewhere.
_OWED = 2.0


def deviations(rows: FloatArray, held: FloatArray | None = None) -> FloatArray:
    """(c,): standard deviations of parameters that rows (r, c), in units of their noise, determine.

    `held` (h, c): directions that constraints hold, taken as certain. Infinite where a parameter is left open.
    """
    size = np.linalg.norm(rows, axis=0)
    size = np.where(size > 0, size, 1.0)
    scaled = rows / size
    moving = np.eye(rows.shape[1]) if held is None or not len(held) else null_space(held / size)
    _, singular, vt = np.linalg.svd(scaled @ moving, full_matrices=True)
    enough = singular > _NULL * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)
    count = int(np.count_nonzero(enough))
    determined = moving @ (vt[:count].T / singular[:count])
    loose = np.abs(moving @ vt[count:].T).max(axis=1, initial=0.0) > _LOOSE
    return np.asarray(np.where(loose, np.inf, np.linalg.norm(determined, axis=1) / size))


def null_space(rows: FloatArray, size: float = float(np.finfo(float).tiny)) -> FloatArray:
    """(c, k): orthonormal columns that the rows (h, c) make zero, beside the largest singular value or `size`."""
    _, singular, vt = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.count_nonzero(singular > _NULL * max(float(singular.max(initial=0.0)), size)))
    return np.asarray(vt[rank:].T)


def owed_to_known(reduction: Reduction, solution: Solution) -> NDArray[np.bool_]:
    """(c,): which parameters are known for what was known beside the data rather than for the data."""
    if solution.known is None:
        return np.zeros(len(solution.values), dtype=bool)
    noise = doubtful_noise(reduction, solution.values)
    c = reduction.n_columns
    alone = deviations(weighted_factor(reduction, noise)[:c, :c])
    together = deviations(weighted_factor(reduction, noise, solution.known)[:c, :c])
    return np.asarray(alone > _OWED * together)
