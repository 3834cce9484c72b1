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

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.candidates.blocks import Batch, Block, Blocks, Sums
from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.candidates.products import Products, folds_of

_RIDGE = 1e-10
_OWN_RIDGE, _RANK = 1e-9, 1e-8


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


def held_out_errors(data: Products, base: IndexArray, noise: FloatArray, kind: str) -> FloatArray:
    """(s, n): squared error of the model alone in every stretch, fitted without the fold that the stretch is in."""
    return score_candidates(data, base, (), noise, kind)[0]


def score_candidates(
    data: Products, base: IndexArray, candidates: Sequence[Candidate], noise: FloatArray, kind: str
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
    return scored(data, Blocks.of(data, base, candidates), candidates, noise, kind)


def scored(
    data: Products, blocks: Blocks, candidates: Sequence[Candidate], noise: FloatArray, kind: str
) -> tuple[FloatArray, list[Score]]:
    """The same from the products that it takes, where they are at hand."""
    s, n = data.n_stretches, data.n_joints
    before, after = np.zeros((s, n)), np.zeros((len(candidates), s, n))
    total = blocks.summed(noise)
    for left_out in folds_of(data, kind):
        here = blocks.at(left_out)
        fit = Fit(total.minus(here.summed(noise)), blocks.portions)
        amplitudes = [fit.amplitudes(portion) for portion in range(len(blocks.portions))]
        for j, block in enumerate(here.joints):
            errors = Errors(block, fit)
            before[left_out, j] = errors.alone
            for number, (portion, own) in enumerate(zip(blocks.portions, amplitudes, strict=True)):
                after[portion.members[:, None], left_out, j] = errors.beside(number, portion, own)
    whole = Fit(total, blocks.portions)
    separability, found = np.zeros(len(candidates)), [np.zeros(0)] * len(candidates)
    for number, portion in enumerate(blocks.portions):
        separability[portion.members] = whole.separability(number)
        for member, own in zip(portion.members, whole.amplitudes(number), strict=True):
            found[member] = own
    measured = data.torque_squared()
    return before, [
        Score(candidate, before, after[k], float(separability[k]), found[k], measured)
        for k, candidate in enumerate(candidates)
    ]


def contributions(
    data: Products, base: IndexArray, candidates: Sequence[Candidate], noise: FloatArray
) -> list[FloatArray]:
    """(s, k) of every candidate with k columns: what each stretch adds to the scores of its parameters (Rao's test).

    That is Zᵀρ, each joint in units of its noise, in directions in which ZᵀZ is one: ρ what the model leaves, Z what is
    left of the columns beside it. Their sum over the stretches is zero but for noise where the candidate explains
    nothing, and its square is what the candidate removes where it does.
    """
    return contributed(Blocks.of(data, base, candidates), len(candidates), noise)


def contributed(blocks: Blocks, count: int, noise: FloatArray) -> list[FloatArray]:
    """The same of `count` candidates from the products that it takes, where they are at hand."""
    fit = Fit(blocks.summed(noise), blocks.portions)
    found = np.zeros((len(blocks.joints[0].yy), blocks.n_extra))
    for block, sigma in zip(blocks.joints, noise, strict=True):
        errors = Errors(block, fit)
        found += (errors.x_rest[:, block.place] - errors.w_rest @ fit.projection[block.have]) / sigma**2
    scores = [np.zeros((0, 0))] * count
    for number, portion in enumerate(blocks.portions):
        for member, columns, unit in zip(portion.members, portion.columns, fit.units(number), strict=True):
            scores[member] = found[:, columns] @ unit
    return scores


def fitted_errors(
    data: Products, base: IndexArray, candidate: Candidate, noise: FloatArray
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Squared errors (s, n) of the model and of the model with a candidate, both fitted to all stretches.

    Returns
    -------
    before (s, n), after (s, n), the candidate's separability, its amplitudes
    """
    blocks = Blocks.of(data, base, [candidate])
    fit = Fit(blocks.summed(noise), blocks.portions)
    own = fit.amplitudes(0)
    before, after = np.zeros((data.n_stretches, data.n_joints)), np.zeros((data.n_stretches, data.n_joints))
    for j, block in enumerate(blocks.joints):
        errors = Errors(block, fit)
        before[:, j], after[:, j] = errors.alone, errors.beside(0, blocks.portions[0], own)[0]
    return before, after, float(fit.separability(0)[0]), own[0]


class Fit:
    """The model fitted on some stretches, and what is left of every candidate column beside it.

    `chi` (b,) are the model's parameters, `projection` (b, c) what the model says of every candidate column.
    """

    def __init__(self, sums: Sums, portions: Sequence[Batch]) -> None:
        scale = np.sqrt(np.maximum(np.diag(sums.ww), np.finfo(float).tiny))
        normal = sums.ww / np.outer(scale, scale) + _RIDGE * np.eye(len(scale))
        solved = _solution(normal, np.column_stack([sums.wy, sums.wx]) / scale[:, None]) / scale[:, None]
        self.chi, self.projection = solved[:, 0], solved[:, 1:]
        right = sums.xy - sums.wx.T @ self.chi
        self._right, self._rest, self._whole = [], [], []
        for portion, own in zip(portions, sums.xx, strict=True):
            said = sums.wx.T[portion.columns] @ self.projection.T[portion.columns].transpose(0, 2, 1)
            self._rest.append(own - said)
            self._whole.append(np.maximum(np.einsum("gkk->gk", own), np.finfo(float).tiny))
            self._right.append(right[portion.columns])

    def amplitudes(self, number: int) -> FloatArray:
        """(g, k): parameters of a portion's candidates, each fitted beside the model."""
        scale, normal = self._scaled(number)
        normal = normal + _OWN_RIDGE * np.eye(normal.shape[2])
        right = self._right[number] / scale
        if normal.shape[2] == 1:
            return np.asarray(right / np.maximum(normal[:, :, 0], np.finfo(float).tiny) / scale)
        inverse = np.linalg.pinv(normal, rcond=_RANK, hermitian=True)
        return np.asarray((inverse @ right[:, :, None])[:, :, 0] / scale)

    def units(self, number: int) -> FloatArray:
        """(g, k, k): directions among a candidate's columns in which what is left of them beside the model is one."""
        scale, normal = self._scaled(number)
        values, vectors = np.linalg.eigh(normal)
        kept = values > np.maximum(_RANK * values[:, -1:], _OWN_RIDGE)
        root = np.where(kept, 1.0 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
        return np.asarray(vectors * root[:, None, :] / scale[:, :, None])

    def separability(self, number: int) -> FloatArray:
        """(g,): share of a candidate's column that is left beside the model, the largest of its columns."""
        share = np.einsum("gkk->gk", self._rest[number]) / self._whole[number]
        return np.asarray(np.sqrt(np.clip(share, 0.0, 1.0)).max(axis=1))

    def _scaled(self, number: int) -> tuple[FloatArray, FloatArray]:
        """The columns' sizes (g, k), and what is left of their products (g, k, k) in units of these."""
        scale = np.sqrt(self._whole[number])
        return scale, self._rest[number] / (scale[:, :, None] * scale[:, None, :])


def _solution(normal: FloatArray, right: FloatArray) -> FloatArray:
    """Solution (b, k) of normal equations (b, b); of all that fit equally well the smallest.

    Without one of the runs, the others may not determine the model: joints that stand still, a single posture.
    """
    try:
        return np.asarray(cho_solve(cho_factor(normal), right))
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(normal, rcond=_RANK, hermitian=True) @ right)


class Errors:
    """One joint's squared errors in stretches, for a fit on others.

    A candidate with its amplitudes β is one column, Z β with Z = X - W P. `alone` (s,) are those of the model, `w_rest`
    (s, w) and `x_rest` (s, x + 1) are Wᵀρ and Xᵀρ of what it leaves.
    """

    def __init__(self, block: Block, fit: Fit) -> None:
        self._block = block
        chi = fit.chi[block.have]
        self._projection = fit.projection[block.have]
        errors = block.yy - 2 * block.wy @ chi + np.einsum("i,sij,j->s", chi, block.ww, chi)
        self.alone = np.maximum(errors, 0.0)
        self.w_rest = block.wy - block.ww @ chi
        self.x_rest = block.xy - chi @ block.wx

    def beside(self, number: int, portion: Batch, amplitudes: FloatArray) -> FloatArray:
        """(g, s): squared errors with each candidate of a portion, whose amplitudes are (g, k)."""
        block = self._block
        shift = np.einsum("bgk,gk->bg", self._projection[:, portion.columns], amplitudes)
        along = -(self.w_rest @ shift)
        size = np.einsum("sbg,bg->sg", block.ww @ shift, shift)
        size += np.einsum("sgkl,gk,gl->sg", block.pairs[number], amplitudes, amplitudes)
        places = block.place[portion.columns]
        for k in range(portion.width):
            own, place = amplitudes[:, k], places[:, k]
            along += own * self.x_rest[:, place]
            size -= 2 * own * np.einsum("sbg,bg->sg", block.wx[:, :, place], shift)
        return np.asarray(np.maximum(self.alone[:, None] - 2 * along + size, 0.0).T)
