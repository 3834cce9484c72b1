"""What is known of parameters beside the data: earlier steps, separate experiments, a description."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from dynident.arrays import FloatArray, IndexArray

_FLAT = 1e-12


@dataclass(frozen=True, eq=False)
class Information:
    """Equations factor χ = right (k, c), (k,), each in units of its own standard deviation.

    They are rows like those of W and Y, already weighted: stacked under the weighted rows they make the estimate that
    takes both for what they are worth.
    """

    factor: FloatArray
    right: FloatArray

    @property
    def n_columns(self) -> int:
        """Number of parameters c."""
        return int(self.factor.shape[1])

    @property
    def rows(self) -> FloatArray:
        """(k, c + 1): [factor | right]."""
        return np.column_stack([self.factor, self.right])

    def and_also(self, other: Information) -> Information:
        """Both together."""
        return Information(np.vstack([self.factor, other.factor]), np.concatenate([self.right, other.right]))


def known_values(values: FloatArray, covariance: FloatArray, columns: IndexArray, n_columns: int) -> Information:
    """Estimates (k,) of the parameters with these numbers (k,), with their covariance (k, k), out of c.

    A variance of zero would be certainty, which no weight can express: it counts as a millionth of a millionth of the
    largest.
    """
    deviation = deviations_of(covariance)
    least = max(float(deviation.max(initial=0.0)), float(np.abs(values).max(initial=0.0)), 1.0) * 1e-9
    deviation = np.maximum(deviation, least)
    correlation = covariance / np.outer(deviation, deviation)
    np.fill_diagonal(correlation, 1.0)
    eigenvalues, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    roots = 1.0 / np.sqrt(np.maximum(eigenvalues, _FLAT))
    whiten = (vectors * roots).T / deviation
    factor = np.zeros((len(values), n_columns))
    factor[:, columns] = whiten
    return Information(factor, whiten @ values)


def covariance_of(factor: FloatArray) -> FloatArray:
    """(c, c): (RᵀR)⁻¹ of a triangular factor."""
    root = root_of(factor)
    return np.asarray(root @ root.T)


def root_of(factor: FloatArray) -> FloatArray:
    """(c, c): R⁻¹ of a triangular factor."""
    return np.asarray(solve_triangular(factor, np.eye(len(factor))))


def deviations_of(covariance: FloatArray) -> FloatArray:
    """(c,): standard deviations, [12.9]; 0 where rounding has left a variance below zero."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))
