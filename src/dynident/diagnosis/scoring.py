"""How much better a model with one more effect predicts data that it was not fitted to: small algebra on factors.

All candidates are projected on the complement of the model (Frisch, Waugh and Lovell) within every fold, so that the
model's own parameters adapt to each of them; the squared error of every stretch of time that was left out follows from
inner products that are computed once.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from dynident.diagnosis.candidates import Candidate
from dynident.estimation import Reduction
from dynident.robot.model import FloatArray

IntArray = NDArray[np.intp]

N_FOLDS = 5
_RIDGE = 1e-10


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


@dataclass(frozen=True, eq=False)
class Score:
    """Squared errors of every stretch and joint (s, n) in N² m², held out, before and after adding a candidate.

    `separability` is the share of the candidate's column that is left after the model (norm, the largest of its
    columns); `amplitudes` its parameters fitted on all data; `measured` (n,) the sum of squared torque of every joint;
    `consistency` the F value of the amplitudes against how much they change when a stretch is left out (jackknife):
    large where every stretch asks for the same amplitudes.
    """

    candidate: Candidate
    before: FloatArray
    after: FloatArray
    separability: float
    amplitudes: FloatArray
    measured: FloatArray
    consistency: float


def folds(n_stretches: int, kind: str) -> list[IntArray]:
    """Stretches left out together: every fifth (`interleaved`) or a fifth in a row (`contiguous`)."""
    order = np.arange(n_stretches)
    count = min(N_FOLDS, n_stretches)
    if kind == "interleaved":
        return [order[k::count] for k in range(count)]
    return [np.asarray(part, dtype=np.intp) for part in np.array_split(order, count)]


def held_out_errors(data: Products, base: IntArray, noise: FloatArray, kind: str) -> FloatArray:
    """(s, n): squared error of the model alone in every stretch, fitted without the fold that the stretch is in."""
    return score_candidates(data, base, (), noise, kind)[0]


def score_candidates(
    data: Products, base: IntArray, candidates: Sequence[Candidate], noise: FloatArray, kind: str
) -> tuple[FloatArray, list[Score]]:
    """Score every candidate beside the model whose columns are `base` (b,).

    Parameters
    ----------
    noise : (n,)
        Standard deviation of every joint's residual, the weight of its rows.
    kind : "interleaved" or "contiguous"

    Returns
    -------
    (s, n) : squared errors of the model alone; and a score for every candidate.
    """
    extra = np.array(sorted({k for candidate in candidates for k in candidate.columns}), dtype=np.intp)
    place = {int(k): i for i, k in enumerate(extra)}
    groups = [np.array([place[k] for k in candidate.columns]) for candidate in candidates]
    s, n = data.n_stretches, data.n_joints
    before = np.zeros((s, n))
    after = np.zeros((len(candidates), s, n))
    total = _weighted_sums(data, base, extra, noise, None)
    for left_out in folds(s, kind):
        train = total.minus(_weighted_sums(data, base, extra, noise, left_out))
        fit = _Fit(train)
        amplitudes = np.zeros((len(extra), len(groups)))
        for k, group in enumerate(groups):
            amplitudes[group, k] = fit.amplitudes(group)
        for j in range(n):
            alone, beside = _test_errors(data, base, extra, left_out, j, fit, amplitudes)
            before[left_out, j] = alone
            after[:, left_out, j] = beside
    whole = _Fit(total)
    stability = _Stability(data, base, extra, noise, whole) if len(extra) else None
    measured = np.array([float(gram[:, -1, -1].sum()) for gram in data.grams])
    return before, [
        Score(
            candidate,
            before,
            after[k],
            whole.separability(groups[k]),
            whole.amplitudes(groups[k]),
            measured,
            stability.f_value(groups[k]) if stability else 0.0,
        )
        for k, candidate in enumerate(candidates)
    ]


@dataclass(frozen=True, eq=False)
class _Sums:
    """Weighted inner products: WᵀW (b, b), WᵀX (b, c), XᵀX (c, c), Wᵀy (b,), Xᵀy (c,)."""

    ww: FloatArray
    wx: FloatArray
    xx: FloatArray
    wy: FloatArray
    xy: FloatArray

    def minus(self, other: _Sums) -> _Sums:
        return _Sums(self.ww - other.ww, self.wx - other.wx, self.xx - other.xx, self.wy - other.wy, self.xy - other.xy)


def _weighted_sums(
    data: Products, base: IntArray, extra: IntArray, noise: FloatArray, stretches: IntArray | None
) -> _Sums:
    b, c = len(base), len(extra)
    sums = _Sums(np.zeros((b, b)), np.zeros((b, c)), np.zeros((c, c)), np.zeros(b), np.zeros(c))
    for gram, where, sigma in zip(data.grams, data.position, noise, strict=True):
        whole = (gram if stretches is None else gram[stretches]).sum(axis=0) / sigma**2
        wi, wp = _present(where, base)
        xi, xp = _present(where, extra)
        sums.ww[np.ix_(wi, wi)] += whole[np.ix_(wp, wp)]
        sums.wx[np.ix_(wi, xi)] += whole[np.ix_(wp, xp)]
        sums.xx[np.ix_(xi, xi)] += whole[np.ix_(xp, xp)]
        sums.wy[wi] += whole[wp, -1]
        sums.xy[xi] += whole[xp, -1]
    return sums


def _present(where: IntArray, columns: IntArray) -> tuple[IntArray, IntArray]:
    """Which of `columns` a joint has, and where."""
    places = where[columns] if len(columns) else np.zeros(0, dtype=np.intp)
    have = np.flatnonzero(places >= 0)
    return have, places[have]


class _Fit:
    """The model fitted on some stretches, and what is left of every candidate column beside it."""

    def __init__(self, sums: _Sums) -> None:
        scale = np.sqrt(np.maximum(np.diag(sums.ww), np.finfo(float).tiny))
        normal = sums.ww / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
        factor = cho_factor(normal)
        self.chi = cho_solve(factor, sums.wy / scale) / scale
        self.projection = cho_solve(factor, sums.wx / scale[:, None]) / scale[:, None]
        self._rest = sums.xx - sums.wx.T @ self.projection
        self._whole = np.diag(sums.xx)
        self._right = sums.xy - sums.wx.T @ self.chi

    def amplitudes(self, group: IntArray) -> FloatArray:
        """Parameters of a candidate fitted beside the model."""
        block = self._rest[np.ix_(group, group)]
        scale = np.sqrt(np.maximum(self._whole[group], np.finfo(float).tiny))
        normal = block / np.outer(scale, scale) + 1e-9 * np.eye(len(group))
        return np.asarray(np.linalg.lstsq(normal, self._right[group] / scale, rcond=1e-8)[0] / scale)

    def separability(self, group: IntArray) -> float:
        """Share of a candidate's column that is left beside the model, the largest of its columns."""
        whole = np.maximum(self._whole[group], np.finfo(float).tiny)
        return float(np.sqrt(np.clip(np.diag(self._rest)[group] / whole, 0.0, 1.0)).max())


class _Stability:
    """How far a candidate's amplitudes move when one stretch of time is left out."""

    def __init__(self, data: Products, base: IntArray, extra: IntArray, noise: FloatArray, fit: _Fit) -> None:
        s, c = data.n_stretches, len(extra)
        self._rests = np.zeros((s, c))  # Zᵀρ of every stretch, Z = X - W P
        self._inner = np.zeros((s, c, c))  # ZᵀZ of every stretch
        for gram, where, sigma in zip(data.grams, data.position, noise, strict=True):
            weight = sigma**-2
            wi, wp = _present(where, base)
            xi, xp = _present(where, extra)
            chi, projection = fit.chi[wi], fit.projection[wi]
            ww, wx = gram[:, wp[:, None], wp], gram[:, wp[:, None], xp]
            self._rests -= weight * ((gram[:, wp, -1] - ww @ chi) @ projection)
            self._rests[:, xi] += weight * (gram[:, xp, -1] - chi @ wx)
            self._inner += weight * (projection.T @ (ww @ projection))
            cross = weight * (projection.T @ wx)
            self._inner[:, :, xi] -= cross
            self._inner[:, xi, :] -= cross.transpose(0, 2, 1)
            self._inner[:, xi[:, None], xi] += weight * gram[:, xp[:, None], xp]

    def f_value(self, group: IntArray) -> float:
        """F of the amplitudes over their jackknife covariance; 0 where the stretches are too few for so many."""
        s, k = len(self._rests), len(group)
        if s <= k + 1:
            return 0.0
        inner = self._inner[:, group[:, None], group]
        total = inner.sum(axis=0)
        scale = np.sqrt(np.maximum(np.diag(total), np.finfo(float).tiny))
        inner = inner / np.outer(scale, scale)
        rests = self._rests[:, group] / scale
        ridge = 1e-9 * np.eye(k)
        total = inner.sum(axis=0) + ridge
        beta = np.linalg.solve(total, rests.sum(axis=0))
        without = np.linalg.solve(total - inner + ridge, (rests.sum(axis=0) - rests)[:, :, None])[:, :, 0]
        moved = without - without.mean(axis=0)
        covariance = (s - 1) / s * (moved.T @ moved)
        try:
            against = float(beta @ np.linalg.solve(covariance, beta))
        except np.linalg.LinAlgError:
            return 0.0
        return max(0.0, against) / k * (s - k) / (s - 1)


def _test_errors(
    data: Products, base: IntArray, extra: IntArray, left_out: IntArray, j: int, fit: _Fit, amplitudes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Joint j's squared errors of the stretches that were left out: (s,) of the model, (C, s) with each candidate.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P; `amplitudes` (c, C) holds all of them.
    """
    gram = data.grams[j][left_out]
    wi, wp = _present(data.position[j], base)
    xi, xp = _present(data.position[j], extra)
    chi, shift, own = fit.chi[wi], (fit.projection @ amplitudes)[wi], amplitudes[xi]
    ww = gram[:, wp[:, None], wp]
    wx = gram[:, wp[:, None], xp]
    wy = gram[:, wp, -1]
    errors = gram[:, -1, -1] - 2 * wy @ chi + np.einsum("i,sij,j->s", chi, ww, chi)
    w_rest = wy - ww @ chi  # Wᵀρ
    x_rest = gram[:, xp, -1] - chi @ wx  # Xᵀρ
    along = x_rest @ own - w_rest @ shift
    size = ((ww @ shift) * shift).sum(axis=1) - 2 * ((wx @ own) * shift).sum(axis=1)
    size += ((gram[:, xp[:, None], xp] @ own) * own).sum(axis=1)
    return np.maximum(errors, 0.0), np.maximum(errors[:, None] - 2 * along + size, 0.0).T
