"""Numbers of closed loops: how near a posture is to singular, and the terms of polynomials."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations_with_replacement
from typing import Protocol, TypeVar

import numpy as np

from dynident.arrays import BoolArray, FloatArray

FactorT = TypeVar("FactorT", bound="Factor")


class Factor(Protocol):
    """What makes another of its own kind when multiplied: an array, an expression."""

    def __mul__(self: FactorT, other: FactorT, /) -> FactorT:
        """The product."""
        ...


def condition_of(slopes: FloatArray) -> FloatArray:
    """(m,): condition of matrices (m, p, p); infinite where one is no number."""
    finite: BoolArray = np.asarray(np.isfinite(slopes).all(axis=(1, 2)))
    known: FloatArray = np.where(finite[:, None, None], slopes, 0.0)
    singular = np.asarray(np.linalg.svd(known, compute_uv=False), dtype=np.float64)
    smallest = singular[:, -1]
    return np.where(smallest > 0, singular[:, 0] / np.where(smallest > 0, smallest, 1.0), np.inf)


def products(factors: Sequence[FactorT], degree: int) -> list[FactorT]:
    """All products of up to `degree` factors, arrays or expressions, each made of one before."""
    made: dict[tuple[int, ...], FactorT] = {}
    for count in range(1, degree + 1):
        for places in combinations_with_replacement(range(len(factors)), count):
            last = factors[places[-1]]
            made[places] = last if count == 1 else made[places[:-1]] * last
    return list(made.values())


def hanging_together(over_driven: BoolArray, over_passive: BoolArray) -> list[tuple[list[int], list[int], list[int]]]:
    """Equations, passive coordinates and driven joints that hang together.

    Parameters
    ----------
    over_driven, over_passive : (e, n), (e, p)
        Which coordinates each equation depends on.
    """
    left = set(range(over_passive.shape[0]))
    groups = []
    while left:
        rows, unknowns = {min(left)}, set[int]()
        while True:
            unknowns = {int(k) for k in np.flatnonzero(over_passive[sorted(rows)].any(axis=0))}
            more = {int(r) for r in np.flatnonzero(over_passive[:, sorted(unknowns)].any(axis=1))} | rows
            if more == rows:
                break
            rows = more
        driven = np.flatnonzero(over_driven[sorted(rows)].any(axis=0))
        groups.append((sorted(rows), sorted(unknowns), [int(j) for j in driven]))
        left -= rows
    return groups
