"""Inner products of all columns and Y, stretch by stretch: what every score is computed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.estimation import Reduction
from dynident.robot.model import FloatArray

IntArray = NDArray[np.intp]

N_FOLDS = 5


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of all columns and Y, stretch by stretch: `grams[j]` (s, p_j + 1, p_j + 1) for joint j.

    `position[j]` maps a global column number to its place in joint j's products, -1 where the joint lacks it.
    """

    grams: tuple[FloatArray, ...]
    position: tuple[IntArray, ...]
    counts: FloatArray

    @property
    def n_stretches(self) -> int:
        """Number of stretches of time."""
        return len(self.grams[0])

    @property
    def n_joints(self) -> int:
        """Number of joints."""
        return len(self.grams)


def products(reduction: Reduction) -> Products:
    """Inner products from triangular factors."""
    grams, position = [], []
    for equation in reduction.equations:
        grams.append(equation.factors.transpose(0, 2, 1) @ equation.factors)
        where = np.full(reduction.n_columns, -1, dtype=np.intp)
        where[equation.columns] = np.arange(len(equation.columns))
        position.append(where)
    return Products(tuple(grams), tuple(position), reduction.equations[0].counts.astype(np.float64))


def folds(n_stretches: int, kind: str) -> list[IntArray]:
    """Stretches left out together: every fifth (`interleaved`) or a fifth in a row (`contiguous`)."""
    order = np.arange(n_stretches)
    count = min(N_FOLDS, n_stretches)
    if kind == "interleaved":
        return [order[k::count] for k in range(count)]
    return [np.asarray(part, dtype=np.intp) for part in np.array_split(order, count)]


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted inner products: WᵀW (b, b), WᵀX (b, c), XᵀX (c, c), Wᵀy (b,), Xᵀy (c,)."""

    ww: FloatArray
    wx: FloatArray
    xx: FloatArray
    wy: FloatArray
    xy: FloatArray

    def minus(self, other: Sums) -> Sums:
        """The products of the rows that are in these and not in the others."""
        return Sums(self.ww - other.ww, self.wx - other.wx, self.xx - other.xx, self.wy - other.wy, self.xy - other.xy)


def weighted_sums(
    data: Products, base: IntArray, extra: IntArray, noise: FloatArray, stretches: IntArray | None
) -> Sums:
    """Products of the model's columns W and the candidates' X over some stretches, each joint in units of its noise."""
    b, c = len(base), len(extra)
    sums = Sums(np.zeros((b, b)), np.zeros((b, c)), np.zeros((c, c)), np.zeros(b), np.zeros(c))
    for gram, where, sigma in zip(data.grams, data.position, noise, strict=True):
        whole = (gram if stretches is None else gram[stretches]).sum(axis=0) / sigma**2
        wi, wp = present(where, base)
        xi, xp = present(where, extra)
        sums.ww[np.ix_(wi, wi)] += whole[np.ix_(wp, wp)]
        sums.wx[np.ix_(wi, xi)] += whole[np.ix_(wp, xp)]
        sums.xx[np.ix_(xi, xi)] += whole[np.ix_(xp, xp)]
        sums.wy[wi] += whole[wp, -1]
        sums.xy[xi] += whole[xp, -1]
    return sums


def present(where: IntArray, columns: IntArray) -> tuple[IntArray, IntArray]:
    """Which of `columns` a joint has, and where in its products they stand."""
    places = where[columns] if len(columns) else np.zeros(0, dtype=np.intp)
    have = np.flatnonzero(places >= 0)
    return have, places[have]
