"""Least squares under constraints that keep parameters possible: bounds, equations, positive semidefinite matrices.

Solved with Clarabel, an interior-point method for cones (Goulart and Chen 2024).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from scipy import sparse

from dynident.errors import DynidentError
from dynident.estimation.factors import FloatArray, IntArray

_SOLVED = ("Solved", "AlmostSolved")
_INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
# What is aimed at, and what is still accepted where rounding stops the progress.
_TOLERANCE, _ACCEPTED = 1e-13, 1e-7
# A bound is held where what is left to it is this much smaller than the force that it is held with, both relative.
_HELD = 1e-5


class InfeasibleError(DynidentError):
    """No parameters satisfy all constraints."""


@dataclass(frozen=True, eq=False)
class MatrixBound:
    """A symmetric matrix that must have no negative eigenvalue: constant + Σ xₖ partₖ ⪰ 0.

    `columns` (k,) are the parameters in it, `parts` (k, m, m) what one of each adds, `constant` (m, m).
    """

    columns: IntArray
    parts: FloatArray
    constant: FloatArray

    def at(self, values: FloatArray) -> FloatArray:
        """(m, m): the matrix for parameters (c,)."""
        return np.asarray(self.constant + np.einsum("k,kij->ij", values[self.columns], self.parts))


@dataclass(frozen=True, eq=False)
class Equations:
    """What parameters must satisfy to the last digit: factor x = right, (e, c) and (e,)."""

    factor: FloatArray
    right: FloatArray


@dataclass(frozen=True, eq=False)
class Constrained:
    """A constrained least-squares solution: `values` (c,).

    `held` (h, c): the directions in which a constraint holds the solution back, one a row; a small change dx that
    keeps all of these constraints where they are satisfies held dx = 0.
    """

    values: FloatArray
    held: FloatArray


def constrained_least_squares(
    factor: FloatArray,
    right: FloatArray,
    matrices: Sequence[MatrixBound] = (),
    not_negative: Sequence[int] | IntArray = (),
    equations: Equations | None = None,
) -> Constrained:
    """Minimise ‖factor x - right‖² over the x (c,) that satisfy all constraints.

    Numbers of very different size make it imprecise: give x in units in which it is about one.

    Parameters
    ----------
    factor, right : (r, c), (r,)
    matrices : sequence of MatrixBound
    not_negative : indices of parameters
    equations : Equations, optional

    Raises
    ------
    InfeasibleError
        Where no parameters satisfy all constraints, or none could be found.
    """
    scale = float(np.abs(factor).max(initial=0.0)) or 1.0
    at_least = np.asarray(not_negative, dtype=np.intp)
    problem = _Problem(factor / scale, right / scale, tuple(matrices), at_least, equations)
    values, duals = problem.solve()
    return Constrained(values, problem.held(values, duals))


@dataclass(frozen=True, eq=False)
class _Problem:
    """The problem in Clarabel's form: ½ zᵀz over (x, z) with factor x - z = right, and s = b - A (x, z) in cones."""

    factor: FloatArray
    right: FloatArray
    matrices: tuple[MatrixBound, ...]
    at_least: IntArray
    equations: Equations | None

    def solve(self) -> tuple[FloatArray, FloatArray]:
        """x (c,), and the dual variables of all rows."""
        r, c = self.factor.shape
        # The residual as a variable of its own: factorᵀfactor would square the condition number.
        quadratic = sparse.diags(np.concatenate([np.zeros(c), np.ones(r)]), format="csc")
        rows, rights, cones = self._rows()
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _TOLERANCE
        settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = settings.reduced_tol_feas = _ACCEPTED
        settings.max_threads = 1
        solver = clarabel.DefaultSolver(quadratic, np.zeros(c + r), sparse.csc_matrix(rows), rights, cones, settings)
        found = solver.solve()
        status = str(found.status)
        if status in _INFEASIBLE:
            raise InfeasibleError("no parameters satisfy all constraints at once", title="Infeasible")
        if status not in _SOLVED or not np.all(np.isfinite(found.x)):
            raise InfeasibleError(
                f"the constrained problem could not be solved ({status}): its numbers differ too much in size",
                title="Not solved",
            )
        return np.asarray(found.x)[:c], np.asarray(found.z)

    def _rows(self) -> tuple[FloatArray, FloatArray, list[object]]:
        r, c = self.factor.shape
        rows = [np.hstack([self.factor, -np.eye(r)])]
        rights = [self.right]
        cones: list[object] = [clarabel.ZeroConeT(r)]
        if self.equations is not None:
            rows.append(np.hstack([self.equations.factor, np.zeros((len(self.equations.right), r))]))
            rights.append(self.equations.right)
            cones.append(clarabel.ZeroConeT(len(self.equations.right)))
        if len(self.at_least):
            bounds = np.zeros((len(self.at_least), c + r))
            bounds[np.arange(len(self.at_least)), self.at_least] = -1.0
            rows.append(bounds)
            rights.append(np.zeros(len(self.at_least)))
            cones.append(clarabel.NonnegativeConeT(len(self.at_least)))
        for bound in self.matrices:
            triangle = np.zeros((len(_packed(bound.constant)), c + r))
            for column, part in zip(bound.columns, bound.parts, strict=True):
                triangle[:, column] = -_packed(part)
            rows.append(triangle)
            rights.append(_packed(bound.constant))
            cones.append(clarabel.PSDTriangleConeT(len(bound.constant)))
        return np.vstack(rows), np.concatenate(rights), cones

    def held(self, values: FloatArray, duals: FloatArray) -> FloatArray:
        """(h, c): gradients of the constraints that hold the solution back."""
        c = len(values)
        first = len(self.right) + (0 if self.equations is None else len(self.equations.right))
        rows = [] if self.equations is None else list(self.equations.factor)
        for index, dual in zip(self.at_least, duals[first:], strict=False):
            if values[index] < _HELD * max(abs(dual), _HELD):
                rows.append(np.eye(c)[index])
        first += len(self.at_least)
        for bound in self.matrices:
            size = len(bound.constant)
            count = size * (size + 1) // 2
            rows += _held_by(bound, values, _unpacked(duals[first : first + count], size))
            first += count
        return np.array(rows).reshape(-1, c)


def _held_by(bound: MatrixBound, values: FloatArray, dual: FloatArray) -> list[FloatArray]:
    """Directions that would change the matrix on the vectors that it is zero on: V's, in vᵢᵀ dJ vⱼ = 0."""
    matrix = bound.at(values)
    eigenvalues, vectors = np.linalg.eigh(matrix)
    force = np.einsum("ik,ij,jk->k", vectors, dual, vectors)
    size = max(float(np.abs(eigenvalues).max(initial=0.0)), np.finfo(float).tiny)
    zero = vectors[:, eigenvalues < _HELD * np.maximum(np.abs(force), _HELD * size)]
    made = []
    for i in range(zero.shape[1]):
        for j in range(i + 1):
            row = np.zeros(len(values))
            row[bound.columns] = np.einsum("i,kij,j->k", zero[:, i], bound.parts, zero[:, j])
            made.append(row)
    return made


def _packed(matrix: FloatArray) -> FloatArray:
    """Upper triangle of a symmetric matrix, column by column, off the diagonal times √2: Clarabel's order."""
    rows, columns = _triangle(len(matrix))
    return np.asarray(matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0)))


def _unpacked(packed: FloatArray, size: int) -> FloatArray:
    rows, columns = _triangle(size)
    matrix = np.zeros((size, size))
    matrix[rows, columns] = packed / np.where(rows == columns, 1.0, np.sqrt(2.0))
    return np.asarray(matrix + np.triu(matrix, 1).T)


def _triangle(size: int) -> tuple[IntArray, IntArray]:
    columns, rows = np.tril_indices(size)
    return rows, columns
