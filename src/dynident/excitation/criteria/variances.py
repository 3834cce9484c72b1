"""Variances of chosen parameters: the diagonal of M⁻¹, all other columns present, and its gradient.

For two rival effects A and B in one model [base | A | B], 1 / (M⁻¹)aa is the squared distance of the contribution of A
from the best that base and B can do instead, for a unit amplitude: minimising the variance of A's parameter is
T-optimality (Atkinson and Fedorov 1975) for the pair.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import FloatArray

# Eigenvalues of the equilibrated M below this share of the largest are rounding errors.
_FLOOR = 1e-13
_LOST = 1e-6
"""Squared share of a parameter in the directions that W does not excite, above which it counts as undetermined."""


@dataclass(frozen=True, eq=False)
class ParameterSelection:
    """Parameters whose variances count, and the weights of the joints' rows.

    Within a group relative variances are added; groups are weighed by the product of their sums, so that no unit
    decides which of them matters.

    Parameters
    ----------
    groups : tuple of tuple of int
        Indices of parameters.
    row_weights : (n,)
        1 / noise of every joint.
    """

    groups: tuple[tuple[int, ...], ...]
    row_weights: FloatArray

    @classmethod
    def select_all(cls, n_parameters: int) -> ParameterSelection:
        """Return all parameters in one group, all rows alike."""
        return cls((tuple(range(n_parameters)),), np.ones(1))

    def weight_rows(self, w: FloatArray) -> FloatArray:
        """Return W (m n, b) with the weights on its rows."""
        return w * np.tile(self.row_weights, len(w) // len(self.row_weights))[:, None]


def build_variance_criterion(
    deciding: ParameterSelection, a_priori: FloatArray
) -> Callable[[FloatArray], tuple[float, FloatArray]]:
    """Return the criterion: log of the (geometric mean over groups of the) sum of variances over a_priori² (b,)."""

    def criterion(w: FloatArray) -> tuple[float, FloatArray]:
        rows = deciding.weight_rows(w)
        inverse = _invert_information(rows)
        value, slope = _sum_groups(deciding.groups, np.diag(inverse), a_priori)
        # d(M⁻¹) = -M⁻¹ dM M⁻¹ with dM = dWᵀ W + Wᵀ dW
        of_rows = -2.0 * rows @ (inverse * slope) @ inverse
        return value, deciding.weight_rows(of_rows)

    return criterion


def sum_variances(deciding: ParameterSelection, a_priori: FloatArray, w: FloatArray) -> float:
    """Return the criterion's value without its logarithm; infinite where a parameter is not determined."""
    variances = compute_inverse_diagonal(deciding.weight_rows(w)).variances
    indices = [k for group in deciding.groups for k in group]
    if not np.isfinite(variances[indices]).all():
        return np.inf
    return float(np.exp(_sum_groups(deciding.groups, variances, a_priori)[0]))


def _sum_groups(
    groups: Sequence[tuple[int, ...]], variances: FloatArray, a_priori: FloatArray
) -> tuple[float, FloatArray]:
    value, slope = 0.0, np.zeros(len(variances))
    for group in groups:
        members = list(group)
        relative = variances[members] / a_priori[members] ** 2
        value += float(np.log(relative.sum())) / len(groups)
        slope[members] += 1.0 / a_priori[members] ** 2 / relative.sum() / len(groups)
    return value, slope


def _invert_information(w: FloatArray) -> FloatArray:
    """Return M⁻¹ (b, b), M = WᵀW, of equilibrated columns so that units do not cost digits."""
    sizes = np.linalg.norm(w, axis=0) + np.finfo(float).tiny
    values, vectors = np.linalg.eigh((w / sizes).T @ (w / sizes))
    # A floor instead of an error: the optimiser may pass through motions that lose rank.
    values = np.maximum(values, _FLOOR * values[-1] + np.finfo(float).tiny)
    inverse: FloatArray = (vectors / values) @ vectors.T / np.outer(sizes, sizes)
    return inverse


@dataclass(frozen=True, eq=False)
class InverseDiagonal:
    """Diagonal of M⁻¹, and how independent every column is.

    Parameters
    ----------
    variances : (b,)
        Diagonal of M⁻¹, infinite where W does not determine a parameter.
    shares : (b,)
        In [0, 1]: the part of a column that the others cannot replace, by its norm. 1 for a column at right angles to
        them, 0 for one that they can replace.
    """

    variances: FloatArray
    shares: FloatArray


def compute_inverse_diagonal(w: FloatArray) -> InverseDiagonal:
    """Return variances of the parameters of W (r, b) for unit noise, and how independent every column is."""
    return compute_diagonal_from_information(w.T @ w)


def compute_diagonal_from_information(information: FloatArray) -> InverseDiagonal:
    """Return the same from the information matrix M (b, b)."""
    squares = np.diag(information)
    absent = squares <= 0
    sizes = np.sqrt(np.where(absent, 1.0, squares))
    values, vectors = np.linalg.eigh(information / np.outer(sizes, sizes))
    is_seen = values > _FLOOR * len(values) * values[-1]
    scaled = (vectors[:, is_seen] ** 2 / values[is_seen]).sum(axis=1)
    lost = absent | ((vectors[:, ~is_seen] ** 2).sum(axis=1) > _LOST)
    variances = np.where(lost, np.inf, scaled / sizes**2)
    shares = np.where(lost, 0.0, 1.0 / np.sqrt(np.maximum(scaled, 1.0)))
    return InverseDiagonal(variances, shares)
