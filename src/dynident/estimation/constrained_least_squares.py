"""Least squares under bounds, equations and positive semidefinite matrices.

Solved with Clarabel, an interior-point method for cones (Goulart and Chen 2024).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import clarabel
import numpy as np
import scipy

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.errors import DynidentError
from dynident.estimation.parameter_covariance import compute_null_space

_SOLVED = ("Solved", "AlmostSolved")
_INFEASIBLE = ("PrimalInfeasible", "AlmostPrimalInfeasible")
# Tolerances: those aimed at, one after the other until one is reached, and the one accepted where rounding stops
# the progress.
_TOLERANCES, _ACCEPTED = (1e-11, 1e-9), 1e-7
# Clarabel adds it to the diagonal of its linear systems, so that they can be factorised.
_REGULARISATION = 1e-10
# A constraint holds the solution where so little is left to it; parameters are about one.
_HELD = 1e-6
# Below this an entry of a constraint is rounding: the equations determine it wholly.
_SETTLED = 1e-9


class InfeasibleError(DynidentError):
    """No parameters satisfy all constraints."""


@dataclass(frozen=True, eq=False)
class MatrixBound:
    """A symmetric matrix that must have no negative eigenvalue: constant + Σ xₖ partₖ ⪰ 0.

    Parameters
    ----------
    columns : (k,)
        Numbers of the parameters in it.
    parts : (k, m, m)
        What a unit of each parameter adds.
    constant : (m, m)
        The matrix where all of these parameters are zero.
    """

    columns: IndexArray
    parts: FloatArray
    constant: FloatArray

    def evaluate(self, values: FloatArray) -> FloatArray:
        """Return the matrix (m, m) for parameters (c,)."""
        return np.asarray(self.constant + np.einsum("k,kij->ij", values[self.columns], self.parts))


@dataclass(frozen=True, eq=False)
class EqualityConstraints:
    """Equations that parameters must satisfy exactly: factor x = right.

    Parameters
    ----------
    factor : (e, c)
        Left sides of the e equations.
    right : (e,)
        Right sides.
    """

    factor: FloatArray
    right: FloatArray

    @cached_property
    def solutions(self) -> tuple[FloatArray, FloatArray]:
        """One solution (c,), and orthonormal directions (c, k): all solutions are it plus these times any numbers."""
        return np.asarray(np.linalg.lstsq(self.factor, self.right)[0]), compute_null_space(self.factor)


@dataclass(frozen=True, eq=False)
class ConstrainedSolution:
    """A constrained least-squares solution.

    Parameters
    ----------
    values : (c,)
        The solution x.
    held : (h, c)
        Directions in which an active constraint holds the solution back, one per row; a small change dx that keeps
        these constraints active satisfies held dx = 0.
    zeros : tuple of int
        Parameters that are held at zero.
    edges : tuple of int
        Indices of the matrices that are singular.
    """

    values: FloatArray
    held: FloatArray
    zeros: tuple[int, ...]
    edges: tuple[int, ...]


def solve_constrained(
    factor: FloatArray,
    right: FloatArray,
    matrices: Sequence[MatrixBound] = (),
    not_negative: Sequence[int] | IndexArray = (),
    equations: EqualityConstraints | None = None,
) -> ConstrainedSolution:
    """Minimise ‖factor x - right‖² over the x (c,) that satisfy all constraints.

    Numbers of very different size make it imprecise: give x in units in which it is about one.

    Parameters
    ----------
    factor, right : (r, c), (r,)
        Weighted rows of the least-squares problem.
    matrices : sequence of MatrixBound
        Symmetric matrices that must have no negative eigenvalue.
    not_negative : sequence of int
        Numbers of parameters that must not be negative.
    equations : EqualityConstraints, optional
        Equations that must hold exactly.

    Returns
    -------
    ConstrainedSolution
        The minimiser, and the constraints that are active in it.

    Raises
    ------
    InfeasibleError
        Where no parameters satisfy all constraints, or none could be found.
    """
    at_least = np.asarray(not_negative, dtype=np.intp)
    problem = _Problem(factor, right, tuple(matrices), at_least, equations)
    return problem.describe_solution(problem.solve())


@dataclass(frozen=True, eq=False)
class _Cone:
    """Rows of constraints on x: right - factor x in a cone of Clarabel."""

    factor: FloatArray
    right: FloatArray
    kind: object

    def eliminate(self, start: FloatArray, moving: FloatArray) -> _Cone:
        """Return the constraints on w, where x = start + moving w."""
        return _Cone(self.factor @ moving, self.right - self.factor @ start, self.kind)

    @property
    def is_settled(self) -> bool:
        """Whether no unknown is left in it."""
        return float(np.abs(self.factor).max(initial=0.0)) < _SETTLED


@dataclass(frozen=True, eq=False)
class _Problem:
    """The problem in Clarabel's form: ½ zᵀz over (w, z) with factor x - z = right, and s = b - A (w, z) in cones.

    The equations are eliminated before: x = start + moving w. As a cone beside bodies at their limit they would leave
    the interior-point method hardly any interior.
    """

    factor: FloatArray
    right: FloatArray
    matrices: tuple[MatrixBound, ...]
    at_least: IndexArray
    equations: EqualityConstraints | None

    def solve(self) -> FloatArray:
        """Return the solution x (c,)."""
        c = self.factor.shape[1]
        start, moving = (np.zeros(c), np.eye(c)) if self.equations is None else self.equations.solutions
        self._check_determined(start)
        left = [cone.eliminate(start, moving) for cone in self._build_cones()]
        cones = [cone for cone in left if not cone.is_settled]
        factor, right = self.factor @ moving, self.right - self.factor @ start
        # Rows that the equations settle say nothing of w.
        open_rows = np.linalg.norm(factor, axis=1) >= _SETTLED * np.linalg.norm(self.factor, axis=1)
        factor, right = factor[open_rows], right[open_rows]
        # A common factor on all rows changes no minimiser, but the solver's tolerances are absolute as well as
        # relative.
        scale = float(np.abs(factor).max(initial=0.0)) or 1.0
        r, k = factor.shape
        # The residual as a variable of its own: factorᵀfactor would square the condition number.
        quadratic = scipy.sparse.diags(np.concatenate([np.zeros(k), np.ones(r)]), format="csc")
        beside = [np.hstack([cone.factor, np.zeros((len(cone.right), r))]) for cone in cones]
        rows = scipy.sparse.csc_matrix(np.vstack([np.hstack([factor / scale, -np.eye(r)]), *beside]))
        rights = np.concatenate([right / scale, *(cone.right for cone in cones)])
        kinds = [clarabel.ZeroConeT(r), *(cone.kind for cone in cones)]
        # A strict tolerance first. Where rounding prevents it, a looser one still gives far more digits than the data
        # have.
        for tolerance in _TOLERANCES:
            answer = clarabel.DefaultSolver(
                quadratic, np.zeros(k + r), rows, rights, kinds, _build_settings(tolerance)
            ).solve()
            status = str(answer.status)
            if status in _SOLVED or status in _INFEASIBLE:
                break
        if status in _INFEASIBLE:
            raise _contradiction_error()
        if status not in _SOLVED or not np.all(np.isfinite(answer.x)):
            raise InfeasibleError(
                f"the constrained problem could not be solved ({status}): its numbers differ too much in size",
                title="Not solved",
            )
        return np.asarray(start + moving @ np.asarray(answer.x)[:k])

    def _check_determined(self, start: FloatArray) -> None:
        """Raise where equations contradict one another, or a bound on what they determine wholly."""
        if self.equations is None:
            return
        gap = np.abs(self.equations.factor @ start - self.equations.right).max(initial=0.0)
        if gap > _ACCEPTED * max(1.0, float(np.abs(self.equations.right).max(initial=0.0))):
            raise _contradiction_error()
        lowest = [
            np.linalg.eigvalsh(m.evaluate(start)).min() for m in self.matrices if self.is_determined[m.columns].all()
        ]
        if np.any(start[self.at_least][self.is_determined[self.at_least]] < -_HELD) or np.any(
            np.array(lowest) < -_HELD
        ):
            raise _contradiction_error()

    @cached_property
    def is_determined(self) -> BoolArray:
        """Which unknowns (c,) the equations determine by themselves."""
        if self.equations is None:
            return np.zeros(self.factor.shape[1], dtype=bool)
        return np.asarray(np.linalg.norm(self.equations.solutions[1], axis=1) < _SETTLED)

    def _build_cones(self) -> list[_Cone]:
        c = self.factor.shape[1]
        cones = [_Cone(-np.eye(c)[[index]], np.zeros(1), clarabel.NonnegativeConeT(1)) for index in self.at_least]
        for bound in self.matrices:
            rows = np.zeros((len(_pack_triangle(bound.constant)), c))
            # Only the upper triangle enters; the factor √2 keeps the inner product that of the whole matrix.
            for column, part in zip(bound.columns, bound.parts, strict=True):
                rows[:, column] = -_pack_triangle(part)
            right, kind = _pack_triangle(bound.constant), clarabel.PSDTriangleConeT(len(bound.constant))
            if len(bound.constant) == 1:
                # Matrices of one entry are inequalities, which the solver treats more exactly as such.
                size = max(float(np.linalg.norm(rows)), np.finfo(float).tiny)
                rows, right, kind = rows / size, right / size, clarabel.NonnegativeConeT(1)
            cones.append(_Cone(rows, right, kind))
        return cones

    def describe_solution(self, values: FloatArray) -> ConstrainedSolution:
        """Return the solution with the constraints that are active in it."""
        c = len(values)
        # Where equations alone determine a parameter no bound holds it.
        zeros = tuple(int(index) for index in self.at_least if values[index] < _HELD and not self.is_determined[index])
        # An equation always holds the solution; a bound only where it is met.
        rows = ([] if self.equations is None else list(self.equations.factor)) + list(np.eye(c)[list(zeros)])
        edges = []
        for place, bound in enumerate(self.matrices):
            if self.is_determined[bound.columns].all():
                continue
            of_matrix = _find_held_directions(bound, values)
            edges += [place] if of_matrix else []
            rows += of_matrix
        return ConstrainedSolution(values, np.array(rows).reshape(-1, c), zeros, tuple(edges))


def _contradiction_error() -> InfeasibleError:
    return InfeasibleError("no parameters satisfy all constraints at once", title="Infeasible")


def _build_settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # The problems are small: more threads would cost more than they save.
    settings.max_threads = 1
    settings.static_regularization_constant = _REGULARISATION
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
    settings.reduced_tol_gap_abs = settings.reduced_tol_gap_rel = settings.reduced_tol_feas = _ACCEPTED
    return settings


def _find_held_directions(bound: MatrixBound, values: FloatArray) -> list[FloatArray]:
    """Return the directions that would change the matrix on its null space: rows of vᵢᵀ dJ vⱼ = 0, V spanning it."""
    eigenvalues, vectors = np.linalg.eigh(bound.evaluate(values))
    # The null space V of J ⪰ 0: to first order J + dJ stays singular along V where Vᵀ dJ V = 0.
    zero = vectors[:, eigenvalues < _HELD * max(float(np.abs(eigenvalues).max()), 1.0)]
    directions = []
    for i in range(zero.shape[1]):
        for j in range(i + 1):
            row = np.zeros(len(values))
            row[bound.columns] = np.einsum("i,kij,j->k", zero[:, i], bound.parts, zero[:, j])
            directions.append(row)
    return directions


def _pack_triangle(matrix: FloatArray) -> FloatArray:
    """Return the upper triangle of a symmetric matrix, column by column, off-diagonals times √2: Clarabel's order."""
    rows, columns = _index_triangle(len(matrix))
    return np.asarray(matrix[rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0)))


@lru_cache(maxsize=64)
def _index_triangle(size: int) -> tuple[IndexArray, IndexArray]:
    # The lower triangle row by row has the order of the upper one column by column.
    columns, rows = np.tril_indices(size)
    return rows, columns
