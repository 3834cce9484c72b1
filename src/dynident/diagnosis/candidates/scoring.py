"""How much better a model with one more effect predicts data that it was not fitted to: small algebra on factors.

All candidates are projected on the complement of the model (Frisch, Waugh and Lovell) within every fold, so that the
model's own parameters adapt to each of them; the squared error of every stretch of time that was left out follows from
inner products that are computed once. Candidates with equally many columns are scored together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.candidates.products import IntArray, Products, Sums, folds_of, present, weighted_sums
from dynident.robot.model import FloatArray

_RIDGE = 1e-10
_OWN_RIDGE, _RANK = 1e-9, 1e-8
# Candidates at once: what their projections take of memory stays in the cache.
_CHUNK = 128


@dataclass(frozen=True, eq=False)
class Score:
    """Squared errors of every stretch and joint (s, n) in N² m², held out, before and after adding a candidate.

    `separability` is the share of the candidate's column that is left after the model (norm, the largest of its
    columns); `amplitudes` its parameters fitted on all data; `measured` (n,) the sum of squared torque of every joint.
    """

    candidate: Candidate
    before: FloatArray
    after: FloatArray
    separability: float
    amplitudes: FloatArray
    measured: FloatArray


@dataclass(frozen=True, eq=False)
class Batch:
    """Candidates with k columns each: their numbers (g,), and their columns (g, k) among the `extra` ones."""

    members: IntArray
    columns: IntArray

    @property
    def width(self) -> int:
        """Number of columns k."""
        return int(self.columns.shape[1])


def extra_columns(candidates: Sequence[Candidate]) -> IntArray:
    """(c,): all columns of the candidates, ascending."""
    return np.array(sorted({k for candidate in candidates for k in candidate.columns}), dtype=np.intp)


def batches(candidates: Sequence[Candidate], extra: IntArray) -> list[Batch]:
    """The candidates by their number of columns, in handy portions."""
    made = []
    for width in sorted({len(candidate.columns) for candidate in candidates}):
        members = np.array([i for i, c in enumerate(candidates) if len(c.columns) == width], dtype=np.intp)
        columns = np.searchsorted(extra, np.array([candidates[i].columns for i in members], dtype=np.intp))
        starts = range(0, len(members), _CHUNK)
        made += [Batch(members[k : k + _CHUNK], columns[k : k + _CHUNK].reshape(-1, width)) for k in starts]
    return made


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
    kind : "interleaved", "contiguous", "runs" or "parts"

    Returns
    -------
    (s, n) : squared errors of the model alone; and a score for every candidate.
    """
    extra = extra_columns(candidates)
    portions = batches(candidates, extra)
    s, n = data.n_stretches, data.n_joints
    before, after = np.zeros((s, n)), np.zeros((len(candidates), s, n))
    total = weighted_sums(data, base, extra, noise, None)
    for left_out in folds_of(data, kind):
        fit = Fit(total.minus(weighted_sums(data, base, extra, noise, left_out)))
        amplitudes = [fit.amplitudes(portion) for portion in portions]
        for j in range(n):
            here = LeftOut(data, base, extra, left_out, j, fit)
            before[left_out, j] = here.alone
            for portion, own in zip(portions, amplitudes, strict=True):
                after[portion.members[:, None], left_out, j] = here.beside(portion, own)
    whole = Fit(total)
    separability, found = np.zeros(len(candidates)), [np.zeros(0)] * len(candidates)
    for portion in portions:
        separability[portion.members] = whole.separability(portion)
        for member, own in zip(portion.members, whole.amplitudes(portion), strict=True):
            found[member] = own
    measured = np.array([float(gram[:, -1, -1].sum()) for gram in data.grams])
    return before, [
        Score(candidate, before, after[k], float(separability[k]), found[k], measured)
        for k, candidate in enumerate(candidates)
    ]


def contributions(
    data: Products, base: IntArray, candidates: Sequence[Candidate], noise: FloatArray
) -> list[FloatArray]:
    """(s, k) of every candidate with k columns: what each stretch adds to the scores of its parameters (Rao's test).

    That is Zᵀρ, each joint in units of its noise, in directions in which ZᵀZ is one: ρ what the model leaves, Z what is
    left of the columns beside it. Their sum over the stretches is zero but for noise where the candidate explains
    nothing, and its square is what the candidate removes where it does.
    """
    extra = extra_columns(candidates)
    fit = Fit(weighted_sums(data, base, extra, noise, None))
    found = np.zeros((data.n_stretches, len(extra)))
    for gram, where, sigma in zip(data.grams, data.position, noise, strict=True):
        wi, wp = present(where, base)
        xi, xp = present(where, extra)
        chi = fit.chi[wi]
        w_rest = gram[:, wp, -1] - gram[:, wp[:, None], wp] @ chi
        found -= w_rest @ fit.projection[wi] / sigma**2
        found[:, xi] += (gram[:, xp, -1] - chi @ gram[:, wp[:, None], xp]) / sigma**2
    scores = [np.zeros((0, 0))] * len(candidates)
    for portion in batches(candidates, extra):
        for member, columns, unit in zip(portion.members, portion.columns, fit.units(portion), strict=True):
            scores[member] = found[:, columns] @ unit
    return scores


def fitted_errors(
    data: Products, base: IntArray, candidate: Candidate, noise: FloatArray
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Squared errors (s, n) of the model and of the model with a candidate, both fitted to all stretches.

    Returns
    -------
    before (s, n), after (s, n), the candidate's separability, its amplitudes
    """
    extra = extra_columns([candidate])
    portion = batches([candidate], extra)[0]
    fit = Fit(weighted_sums(data, base, extra, noise, None))
    own = fit.amplitudes(portion)
    before, after = np.zeros((data.n_stretches, data.n_joints)), np.zeros((data.n_stretches, data.n_joints))
    for j in range(data.n_joints):
        here = LeftOut(data, base, extra, np.arange(data.n_stretches), j, fit)
        before[:, j], after[:, j] = here.alone, here.beside(portion, own)[0]
    return before, after, float(fit.separability(portion)[0]), own[0]


class Fit:
    """The model fitted on some stretches, and what is left of every candidate column beside it.

    `chi` (b,) are the model's parameters, `projection` (b, c) what the model says of every candidate column.
    """

    def __init__(self, sums: Sums) -> None:
        scale = np.sqrt(np.maximum(np.diag(sums.ww), np.finfo(float).tiny))
        normal = sums.ww / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
        solved = _solution(normal, np.column_stack([sums.wy, sums.wx]) / scale[:, None]) / scale[:, None]
        self.chi, self.projection = solved[:, 0], solved[:, 1:]
        self._rest = sums.xx - sums.wx.T @ self.projection
        self._whole = np.maximum(np.diag(sums.xx), np.finfo(float).tiny)
        self._right = sums.xy - sums.wx.T @ self.chi

    def amplitudes(self, portion: Batch) -> FloatArray:
        """(g, k): parameters of candidates, each fitted beside the model."""
        columns = portion.columns
        scale = np.sqrt(self._whole[columns])
        normal = self._rest[columns[:, :, None], columns[:, None, :]] / (scale[:, :, None] * scale[:, None, :])
        normal = normal + _OWN_RIDGE * np.eye(portion.width)
        right = self._right[columns] / scale
        if portion.width == 1:
            return np.asarray(right / np.maximum(normal[:, :, 0], np.finfo(float).tiny) / scale)
        inverse = np.linalg.pinv(normal, rcond=_RANK, hermitian=True)
        return np.asarray((inverse @ right[:, :, None])[:, :, 0] / scale)

    def units(self, portion: Batch) -> FloatArray:
        """(g, k, k): directions among a candidate's columns in which what is left of them beside the model is one."""
        columns = portion.columns
        scale = np.sqrt(self._whole[columns])
        normal = self._rest[columns[:, :, None], columns[:, None, :]] / (scale[:, :, None] * scale[:, None, :])
        values, vectors = np.linalg.eigh(normal)
        kept = values > np.maximum(_RANK * values[:, -1:], _OWN_RIDGE)
        root = np.where(kept, 1.0 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
        return np.asarray(vectors * root[:, None, :] / scale[:, :, None])

    def separability(self, portion: Batch) -> FloatArray:
        """(g,): share of a candidate's column that is left beside the model, the largest of its columns."""
        share = np.diag(self._rest)[portion.columns] / self._whole[portion.columns]
        return np.asarray(np.sqrt(np.clip(share, 0.0, 1.0)).max(axis=1))


def _solution(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solution (b, k) of normal equations (b, b); of all that fit equally well the smallest.

    Without one of the runs, the others may not determine the model: joints that stand still, a single posture.
    """
    try:
        return np.asarray(cho_solve(cho_factor(normal), right))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(normal, rcond=_RANK, hermitian=True) @ right)


class LeftOut:
    """One joint's squared errors in stretches, for a fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P.
    """

    def __init__(
        self, data: Products, base: IntArray, extra: IntArray, stretches: IntArray, joint: int, fit: Fit
    ) -> None:
        gram = data.grams[joint][stretches]
        self._wi, wp = present(data.position[joint], base)
        xi, xp = present(data.position[joint], extra)
        # A row of zeros stands for the columns that this joint lacks.
        self._place = np.full(len(extra), len(xi), dtype=np.intp)
        self._place[xi] = np.arange(len(xi))
        chi = fit.chi[self._wi]
        self._projection = fit.projection[self._wi]
        self._ww = gram[:, wp[:, None], wp]
        self._wx = np.pad(gram[:, wp[:, None], xp], ((0, 0), (0, 0), (0, 1)))
        self._xx = np.pad(gram[:, xp[:, None], xp], ((0, 0), (0, 1), (0, 1)))
        wy = gram[:, wp, -1]
        errors = gram[:, -1, -1] - 2 * wy @ chi + np.einsum("i,sij,j->s", chi, self._ww, chi)
        self.alone = np.maximum(errors, 0.0)
        self._w_rest = wy - self._ww @ chi  # Wᵀρ
        self._x_rest = np.pad(gram[:, xp, -1] - chi @ self._wx[:, :, :-1], ((0, 0), (0, 1)))  # Xᵀρ

    def beside(self, portion: Batch, amplitudes: FloatArray) -> FloatArray:
        """(g, s): squared errors with each candidate of a portion, whose amplitudes are (g, k)."""
        shift = np.zeros((len(self._wi), len(portion.members)))
        for k in range(portion.width):
            shift += self._projection[:, portion.columns[:, k]] * amplitudes[:, k]
        along = -(self._w_rest @ shift)
        size = np.einsum("sbg,bg->sg", self._ww @ shift, shift)
        places = self._place[portion.columns]
        for k in range(portion.width):
            own, place = amplitudes[:, k], places[:, k]
            along += own * self._x_rest[:, place]
            size -= 2 * own * np.einsum("sbg,bg->sg", self._wx[:, :, place], shift)
            for other in range(portion.width):
                size += own * amplitudes[:, other] * self._xx[:, place, places[:, other]]
        return np.asarray(np.maximum(self.alone[:, None] - 2 * along + size, 0.0).T)
