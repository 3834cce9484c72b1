"""Numerics of closed loops: condition of a posture, terms of polynomials, groups of equations."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import Protocol, TypeVar

import numpy as np

from dynident.arrays import BoolArray, FloatArray

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
    """Return all products of up to `degree` factors, each computed from one of a degree less."""
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
