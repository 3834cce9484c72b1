"""Inner products of all columns and Y, stretch by stretch: what every score is computed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.estimation import Reduction
from dynident.robot.model import FloatArray

IntArray = NDArray[np.intp]

N_FOLDS = 5
N_PARTS = 10
# Share of a column's squares in one fold from which on the others do not determine its parameter.
_NEARLY_ALL = 0.9
# A pause of this share of all the time parts two runs.
_PAUSE = 0.1


@dataclass(frozen=True, eq=False)
class Products:
    """Inner products of all columns and Y, stretch by stretch: `grams[j]` (s, p_j + 1, p_j + 1) for joint j.

    `position[j]` maps a global column number to its place in joint j's products, -1 where the joint lacks it; `counts`
    (s, n) are the rows, `run` (s,) numbers the runs that the stretches are of.
    """

    grams: tuple[FloatArray, ...]
    position: tuple[IntArray, ...]
    counts: FloatArray
    run: IntArray

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
    counts = np.array([equation.counts for equation in reduction.equations]).T.astype(np.float64)
    return Products(tuple(grams), tuple(position), counts, runs_of(reduction.spans))


def runs_of(spans: FloatArray) -> IntArray:
    """(s,): number of the run of every stretch, whose first and last times are spans (s, 2)."""
    pause = spans[1:, 0] - spans[:-1, 1]
    least = _PAUSE * float((spans[:, 1] - spans[:, 0]).sum())
    starts = (pause > least) | (spans[1:, 0] < spans[:-1, 0])
    return np.concatenate([[0], np.cumsum(starts)]).astype(np.intp)


def folds(n_stretches: int, kind: str) -> list[IntArray]:
    """Stretches left out together: every fifth (`interleaved`) or a fifth in a row (`contiguous`)."""
    order = np.arange(n_stretches)
    count = min(N_FOLDS, n_stretches)
    if kind == "interleaved":
        return [order[k::count] for k in range(count)]
    return [np.asarray(part, dtype=np.intp) for part in np.array_split(order, count)]


def folds_of(data: Products, kind: str) -> list[IntArray]:
    """The folds of some data: whole `runs`, `parts` of each (a tenth in a row), or as `folds`.

    A fifth in a row is one of every run: a fast motion of all joints beside a long test of a single one would else be
    left out as a whole, and the model of most joints unknown without it. Runs too short for that count as one.
    """
    each = [np.flatnonzero(data.run == run) for run in np.unique(data.run)]
    if kind == "runs":
        return each
    if kind == "parts":
        return [part for own in each for part in _parts(own)]
    if kind == "interleaved":
        return folds(data.n_stretches, kind)
    long = [own for own in each if len(own) >= N_FOLDS]
    short = [own for own in each if len(own) < N_FOLDS]
    together = [np.concatenate(short)] if short else []
    parts = zip(*(np.array_split(own, N_FOLDS) for own in long + together), strict=True)
    return [fold for fold in map(np.concatenate, parts) if len(fold)]


def runs_can_be_left_out(data: Products, base: IntArray) -> bool:
    """Whether there are several runs, and the columns of a model are known without any one of them."""
    runs = folds_of(data, "runs")
    return len(runs) > 1 and not any(_takes_all(data, base, run) for run in runs)


def _parts(stretches: IntArray) -> list[IntArray]:
    return [part for part in np.array_split(stretches, min(N_PARTS, len(stretches))) if len(part)]


def _takes_all(data: Products, base: IntArray, part: IntArray) -> bool:
    """Whether a fold holds a whole run and with it nearly all that some column of the model shows."""
    outside = np.delete(data.run, part)
    if not set(data.run[part]) - set(outside):
        return False
    inside, whole = np.zeros(len(base)), np.zeros(len(base))
    for gram, where in zip(data.grams, data.position, strict=True):
        have, places = present(where, base)
        squares = gram[:, places, places]
        inside[have] += squares[part].sum(axis=0)
        whole[have] += squares.sum(axis=0)
    return bool((inside > _NEARLY_ALL * whole).any())


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
