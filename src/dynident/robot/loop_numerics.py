"""Numerical helpers of closed loops: condition numbers, polynomial terms, sparse elimination with chosen pivots.

Elimination solves small sparse systems of expressions in an order that is chosen once on numbers. CasADi's own `solve`
of expressions knows no numbers, so it must make every pivot safe by an orthogonalisation, which takes several times as
many operations as the elimination of a matrix that is mostly zeros.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import Protocol, TypeVar

import casadi as ca
import numpy as np

import dynident.expressions  # noqa: F401 - threads may use CasADi
from dynident.array_types import BoolArray, FloatArray

_SAFE = 0.05
"""A pivot is at least this share of the largest number left in its row, in every one of the sampled matrices."""
_ZERO = 1e-14
"""Share of the largest entry below which an entry counts as zero: rounding."""

Pivots = tuple[tuple[int, int], ...]


def choose_pivots(matrices: FloatArray) -> Pivots:
    """Choose the order of elimination for matrices (m, p, p) of one sparsity pattern.

    Each step takes the cheapest safe pivot (Markowitz, 1957): the product of the numbers of other entries in its row
    and in its column bounds the entries that it can fill. If no pivot is safe, the safest one is taken.

    Parameters
    ----------
    matrices : ndarray (m, p, p)
        Samples of the matrix.

    Returns
    -------
    tuple of (row, column)
        The pivots in the order of elimination.
    """
    remaining = np.array(matrices)
    size = remaining.shape[1]
    rows, columns = list(range(size)), list(range(size))
    largest = float(np.abs(remaining).max()) or 1.0
    pivots: list[tuple[int, int]] = []
    while rows:
        part = np.abs(remaining[:, rows][:, :, columns])
        nonzero = part.max(axis=0) > _ZERO * largest
        reach = part.max(axis=2, keepdims=True)
        # The worst case over all samples: the order is fixed in the generated code, so every pivot must be safe in
        # every posture.
        share = np.min(part / np.where(reach > 0, reach, 1.0), axis=0)
        cost = np.outer(nonzero.sum(axis=1) - 1, nonzero.sum(axis=0) - 1).astype(float)
        safe = nonzero & (share >= _SAFE)
        # Subtracting the share, which is at most one, decides between pivots of equal cost for the safer one.
        best = np.argmin(np.where(safe, cost - share, np.inf)) if safe.any() else np.argmax(share)
        row_place, column_place = np.unravel_index(int(best), share.shape)
        row, column = rows[row_place], columns[column_place]
        pivots.append((row, column))
        rows.remove(row)
        columns.remove(column)
        pivot = remaining[:, row, column]
        factors = remaining[:, rows, column] / np.where(pivot == 0, 1.0, pivot)[:, None]
        remaining[:, np.array(rows, dtype=int)[:, None], columns] -= (
            factors[:, :, None] * remaining[:, row, columns][:, None, :]
        )
    return tuple(pivots)


def solve_sparse(matrix: ca.SX, right: ca.SX, pivots: Pivots) -> ca.SX:
    """Return matrix⁻¹ right, by elimination in a given order.

    Parameters
    ----------
    matrix : SX (p, p)
        The matrix, of the sparsity pattern that the pivots were chosen for.
    right : SX (p, k)
        Right sides.
    pivots : tuple of (row, column)
        Order of elimination, from `choose_pivots`.

    Returns
    -------
    SX (p, k)
        The solutions.
    """
    entries = _list_entries(matrix)
    sides = _list_entries(right)
    done: set[int] = set()
    for row, column in pivots:
        done.add(row)
        pivot = entries[row][column]
        for other in range(matrix.shape[0]):
            if other in done or column not in entries[other]:
                continue
            factor = entries[other].pop(column) / pivot
            _subtract_multiple(entries[other], entries[row], factor, skip=column)
            _subtract_multiple(sides[other], sides[row], factor)
    # Back substitution, in the reverse order of the pivots.
    value = ca.SX(matrix.shape[0], right.shape[1])
    for row, column in reversed(pivots):
        for other, factor in entries[row].items():
            if other != column:
                _subtract_multiple(sides[row], {k: value[other, k] for k in _list_columns(value, other)}, factor)
        for k, side in sides[row].items():
            value[column, k] = side / entries[row][column]
    return value


def _list_entries(matrix: ca.SX) -> list[dict[int, ca.SX]]:
    rows_of_entries: list[dict[int, ca.SX]] = [{} for _ in range(matrix.shape[0])]
    rows, columns = ca.sparsify(matrix).sparsity().get_triplet()
    for row, column in zip(rows, columns, strict=True):
        rows_of_entries[row][column] = matrix[row, column]
    return rows_of_entries


def _subtract_multiple(target: dict[int, ca.SX], other: dict[int, ca.SX], factor: ca.SX, skip: int = -1) -> None:
    for place, entry in other.items():
        if place != skip:
            target[place] = target[place] - factor * entry if place in target else -factor * entry


def _list_columns(matrix: ca.SX, row: int) -> Sequence[int]:
    return [k for k in range(matrix.shape[1]) if matrix.sparsity().has_nz(row, k)]


FactorT = TypeVar("FactorT", bound="Factor")


class Factor(Protocol):
    """A factor whose products are of its own type: an array or an expression."""

    def __mul__(self: FactorT, other: FactorT, /) -> FactorT:
        """Return the product."""
        ...


def compute_condition(slopes: FloatArray) -> FloatArray:
    """Return the condition numbers (m,) of matrices (m, p, p); infinite for a singular one or one with NaN."""
    finite: BoolArray = np.asarray(np.isfinite(slopes).all(axis=(1, 2)))
    finite_slopes: FloatArray = np.where(finite[:, None, None], slopes, 0.0)
    singular = np.asarray(np.linalg.svd(finite_slopes, compute_uv=False), dtype=np.float64)
    smallest = singular[:, -1]
    return np.where(smallest > 0, singular[:, 0] / np.where(smallest > 0, smallest, 1.0), np.inf)


def list_products(factors: Sequence[FactorT], degree: int) -> list[FactorT]:
    """Return all products of up to `degree` factors, each computed from one of a degree less.

    Parameters
    ----------
    factors : sequence
        Arrays or expressions.
    degree : int
        Largest number of factors of a product.

    Returns
    -------
    list
        Without the empty product; products of fewer factors first.
    """
    products_by_places: dict[tuple[int, ...], FactorT] = {}
    for count in range(1, degree + 1):
        for places in combinations_with_replacement(range(len(factors)), count):
            last = factors[places[-1]]
            products_by_places[places] = last if count == 1 else products_by_places[places[:-1]] * last
    return list(products_by_places.values())


def group_equations(over_driven: BoolArray, over_passive: BoolArray) -> list[tuple[list[int], list[int], list[int]]]:
    """Return groups of equations, passive coordinates and driven joints that are coupled with one another.

    Parameters
    ----------
    over_driven, over_passive : bool arrays (e, n), (e, p)
        Which coordinates each equation depends on.

    Returns
    -------
    list of (rows, unknowns, driven)
        Indices of equations, passive coordinates and driven joints, ascending.
    """
    remaining_rows = set(range(over_passive.shape[0]))
    groups = []
    while remaining_rows:
        rows, unknowns = {min(remaining_rows)}, set[int]()
        # Connected components: add equations that share an unknown until no more come. Driven joints do not couple.
        while True:
            unknowns = {int(k) for k in np.flatnonzero(over_passive[sorted(rows)].any(axis=0))}
            more = {int(r) for r in np.flatnonzero(over_passive[:, sorted(unknowns)].any(axis=1))} | rows
            if more == rows:
                break
            rows = more
        driven = np.flatnonzero(over_driven[sorted(rows)].any(axis=0))
        groups.append((sorted(rows), sorted(unknowns), [int(j) for j in driven]))
        remaining_rows -= rows
    return groups
