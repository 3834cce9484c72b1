"""Standard deviations where rows may leave parameters undetermined, and which of them rest on prior knowledge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.arrays import FloatArray
from dynident.estimation.factors import Reduction
from dynident.estimation.least_squares import Solution, build_weighted_factor, compute_correlated_noise

_NULL, _LOOSE = 1e-9, 1e-5
# More than so many times as sure as by the data alone: three quarters of what is known come from elsewhere.
_OWED = 2.0


def compute_standard_deviations(rows: FloatArray, held: FloatArray | None = None) -> FloatArray:
    """Return the standard deviations (c,) of parameters that rows determine.

    Parameters
    ----------
    rows : (r, c)
        Rows of W in units of their noise.
    held : (h, c), optional
        Directions that constraints hold, taken as certain.

    Returns
    -------
    (c,) array, infinite where a parameter is left undetermined
    """
    size = np.linalg.norm(rows, axis=0)
    size = np.where(size > 0, size, 1.0)
    scaled = rows / size
    moving = np.eye(rows.shape[1]) if held is None or not len(held) else compute_null_space(held / size)
    _, singular, vt = np.linalg.svd(scaled @ moving, full_matrices=True)
    enough = singular > _NULL * max(float(singular.max(initial=0.0)), np.finfo(float).tiny)
    count = int(np.count_nonzero(enough))
    determined = moving @ (vt[:count].T / singular[:count])
    # A parameter counts as undetermined as soon as an undetermined direction contains it by more than rounding.
    loose = np.abs(moving @ vt[count:].T).max(axis=1, initial=0.0) > _LOOSE
    return np.asarray(np.where(loose, np.inf, np.linalg.norm(determined, axis=1) / size))


def compute_null_space(rows: FloatArray, size: float = float(np.finfo(float).tiny)) -> FloatArray:
    """Return orthonormal columns (c, k) that the rows (h, c) map to zero.

    A singular value counts as zero when it is small compared to the largest one, or to `size` where that is larger.
    """
    _, singular, vt = np.linalg.svd(rows, full_matrices=True)
    rank = int(np.count_nonzero(singular > _NULL * max(float(singular.max(initial=0.0)), size)))
    return np.asarray(vt[rank:].T)


def find_prior_dominated(reduction: Reduction, solution: Solution) -> NDArray[np.bool_]:
    """Return which parameters (c,) rest on prior knowledge rather than on the data."""
    if solution.known is None:
        return np.zeros(len(solution.values), dtype=bool)
    noise = compute_correlated_noise(reduction, solution.values)
    c = reduction.n_columns
    # The noise is corrected for correlated rows, as it is where prior knowledge is weighed against the data.
    alone = compute_standard_deviations(build_weighted_factor(reduction, noise)[:c, :c])
    together = compute_standard_deviations(build_weighted_factor(reduction, noise, solution.known)[:c, :c])
    return np.asarray(alone > _OWED * together)
