"""Prior knowledge as information rows that are added to factors, and the solutions of data and prior together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.estimation.qr_decomposition import compute_r_factor

# Smallest eigenvalue of a correlation matrix that is taken at its word: below it rounding decides.
_FLAT = 1e-12

# Weight of what is certain, as a multiple of all data: half of the digits, which leaves the other half to the other
# columns.
_CERTAIN = 1e8


@dataclass(frozen=True, eq=False)
class PriorInformation:
    """Equations factor χ = right, each in units of its own standard deviation.

    They are rows like those of W and Y, already weighted: stacked under the weighted rows they give the estimate that
    weighs both by their uncertainty.

    Parameters
    ----------
    factor : (k, c)
        Left sides of the k equations, in the units of 1 / χ.
    right : (k,)
        Right sides, without unit.
    held : (c,), optional
        Values of parameters that are held exactly; NaN for the others. They are no rows, as no weight expresses
        certainty: a solver moves their torque to the right-hand side and estimates the others alone.
    """

    factor: FloatArray
    right: FloatArray
    held: FloatArray | None = None

    @property
    def n_columns(self) -> int:
        """Number of parameters c."""
        return int(self.factor.shape[1])

    @property
    def rows(self) -> FloatArray:
        """The matrix [factor | right], (k, c + 1)."""
        return np.column_stack([self.factor, self.right])

    @property
    def is_held(self) -> BoolArray:
        """Which parameters (c,) are held exactly."""
        return np.zeros(self.n_columns, dtype=bool) if self.held is None else ~np.isnan(self.held)

    @property
    def has_rows(self) -> bool:
        """Whether there is anything to weigh against data; values that are held alone are not."""
        return len(self.right) > 0

    def combine_with(self, other: PriorInformation) -> PriorInformation:
        """Return the equations of both; parameters that are held are those of this one."""
        rows = np.vstack([self.factor, other.factor])
        return PriorInformation(rows, np.concatenate([self.right, other.right]), self.held)

    def select_columns(self, columns: Sequence[int] | IndexArray) -> PriorInformation:
        """Return the same equations where all parameters but these are zero."""
        chosen = np.asarray(columns, dtype=np.intp)
        return PriorInformation(self.factor[:, chosen], self.right, None if self.held is None else self.held[chosen])

    def remove_held(self) -> PriorInformation:
        """Return the same equations of the parameters that are not held."""
        if self.held is None:
            return self
        where = self.is_held
        return PriorInformation(self.factor[:, ~where], self.right - self.factor[:, where] @ self.held[where])

    def restore_held(self, values: FloatArray) -> FloatArray:
        """Return all parameters (c,), of which `values` are those that are not held."""
        if self.held is None:
            return values
        whole = self.held.copy()
        whole[~self.is_held] = values
        return whole

    def compute_products(self, columns: IndexArray, squares: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Compute what the equations add to normal equations of some columns.

        Parameters
        ----------
        columns : (b,)
            Numbers of the columns; those that are beyond the c parameters are in none of the equations.
        squares : (b,)
            Sum of squares of each column in the data. A held parameter, or an equation that is far more certain than
            all data, counts as `_CERTAIN` times these: normal equations would lose what the data say of other columns
            in rounding.

        Returns
        -------
        tuple of (b, b), (b,)
            FᵀF and Fᵀr.
        """
        factor = np.zeros((len(self.factor), len(columns)))
        own = columns < self.n_columns
        factor[:, own] = self.factor[:, columns[own]]
        shares = np.divide(factor**2, _CERTAIN * squares, out=np.zeros_like(factor), where=squares > 0.0)
        scale = 1.0 / np.sqrt(np.maximum(shares.max(axis=1, initial=0.0), 1.0))
        factor *= scale[:, None]
        weights, values = np.zeros(len(columns)), np.zeros(len(columns))
        if self.held is not None:
            # Any weight holds a column that these data lack; it only has to outweigh the equations.
            sizes = np.where(squares > 0.0, squares, 1.0 + (factor**2).sum(axis=0))
            weights[own] = np.where(self.is_held[columns[own]], _CERTAIN * sizes[own], 0.0)
            values[own] = np.nan_to_num(self.held[columns[own]])
        return factor.T @ factor + np.diag(weights), factor.T @ (self.right * scale) + weights * values


def build_prior(values: FloatArray, covariance: FloatArray, columns: IndexArray, n_columns: int) -> PriorInformation:
    """Turn estimates and their covariance into equations of prior knowledge.

    A variance of zero would be certainty, which no weight can express: it counts as a millionth of a millionth of the
    largest.

    Parameters
    ----------
    values : (k,)
        Estimates of the parameters.
    covariance : (k, k)
        Covariance of their errors.
    columns : (k,)
        Numbers of these parameters.
    n_columns : int
        Number of all parameters c.

    Returns
    -------
    PriorInformation
        The k equations, in all c parameters.
    """
    deviation = extract_deviations(covariance)
    least = max(float(deviation.max(initial=0.0)), float(np.abs(values).max(initial=0.0)), 1.0) * 1e-9
    deviation = np.maximum(deviation, least)
    correlation = covariance / np.outer(deviation, deviation)
    np.fill_diagonal(correlation, 1.0)
    # The correlation matrix instead of the covariance: parameters differ in size by many orders of magnitude, and the
    # smallest would be lost in rounding.
    eigenvalues, vectors = np.linalg.eigh(0.5 * (correlation + correlation.T))
    roots = 1.0 / np.sqrt(np.maximum(eigenvalues, _FLAT))
    whiten = (vectors * roots).T / deviation
    # With C = D P D (P the correlation matrix) and P = V Λ Vᵀ, the rows Λ^-½ Vᵀ D⁻¹ have FᵀF = C⁻¹.
    factor = np.zeros((len(values), n_columns))
    factor[:, columns] = whiten
    return PriorInformation(factor, whiten @ values)


def invert_information(factor: FloatArray) -> FloatArray:
    """Return (RᵀR)⁻¹ (c, c) of a triangular factor R."""
    root = invert_factor(factor)
    return np.asarray(root @ root.T)


def invert_factor(factor: FloatArray) -> FloatArray:
    """Return R⁻¹ (c, c) of a triangular factor R."""
    return np.asarray(solve_triangular(factor, np.eye(len(factor))))


def extract_deviations(covariance: FloatArray) -> FloatArray:
    """Return the standard deviations (c,) of a covariance, [12.9]; 0 where rounding left a negative variance."""
    return np.asarray(np.sqrt(np.maximum(np.diag(covariance), 0.0)))


@dataclass(frozen=True, eq=False)
class Solution:
    """Least-squares estimates and the factor that they were solved from.

    Parameters
    ----------
    values, noise : (c,), (n,)
        Estimates χ, and the noise of every equation, by which its rows were weighted.
    factor : (c, c)
        Triangular factor R of the weighted W, so that (WᵀW)⁻¹ = R⁻¹R⁻ᵀ.
    known : PriorInformation, optional
        Prior knowledge; its rows are part of R.
    free : (c, f), optional
        Directions that active constraints, and parameters that are held, leave free.
    converged : bool
        Whether the weights have settled.
    """

    values: FloatArray
    noise: FloatArray
    factor: FloatArray
    known: PriorInformation | None = None
    free: FloatArray | None = None
    converged: bool = True

    @property
    def is_held(self) -> BoolArray:
        """Which parameters (c,) are held at a known value."""
        return np.zeros(len(self.values), dtype=bool) if self.known is None else self.known.is_held

    @property
    def scales(self) -> FloatArray:
        """Norms (c,) of the weighted columns of W."""
        return np.asarray(np.linalg.norm(self.factor, axis=0))

    @property
    def normal_inverse(self) -> FloatArray:
        """(WᵀW)⁻¹ (c, c) of the weighted W; restricted to the free directions where constraints are active."""
        root = self.root
        return np.asarray(root @ root.T)

    @property
    def root(self) -> FloatArray:
        """A root (c, f) of `normal_inverse`, with one column for every free direction."""
        if self.free is None:
            return invert_factor(self.factor)
        return np.asarray(self.free @ invert_factor(compute_r_factor(self.factor @ self.free)))
