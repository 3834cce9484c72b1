"""How much better a model with one more effect predicts data that it was not fitted to: small algebra on factors.

All candidates are projected on the complement of the model (Frisch, Waugh and Lovell) within every fold, so that the
model's own parameters adapt to each of them; the squared error of every stretch of time that was left out follows from
inner products that are computed once. Candidates with equally many columns are scored together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.blocks import JointBlocks
from dynident.diagnosis.candidates.fold_fit import FoldFit, ProductSums
from dynident.diagnosis.candidates.pool import Candidate
from dynident.diagnosis.candidates.products import Products, split_data_folds

_SPANNED = 1e-6


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


def compute_held_out_errors(data: Products, base: IndexArray, noise: FloatArray, kind: str) -> FloatArray:
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
    blocks = JointBlocks.from_products(data, base, candidates)
    return score_blocks(data, blocks, blocks.sum_products(noise), candidates, noise, kind)


def score_blocks(
    data: Products,
    blocks: JointBlocks,
    total: ProductSums,
    candidates: Sequence[Candidate],
    noise: FloatArray,
    kind: str,
) -> tuple[FloatArray, list[Score]]:
    """The same from the products that it takes and their sums over all stretches, where they are at hand."""
    s, n = data.n_stretches, data.n_joints
    before, after = np.zeros((s, n)), np.zeros((len(candidates), s, n))
    members = np.array([k for portion in blocks.portions for k in portion.members], dtype=np.intp)
    for left_out in split_data_folds(data, kind):
        here = blocks.select_stretches(left_out)
        # Sums over the training blocks are those of all blocks minus those left out: no product is summed twice.
        fit = FoldFit(total.subtract(here.sum_products(noise)), blocks.portions)
        amplitudes = blocks.fit_amplitudes(fit)
        for j, block in enumerate(here.joints):
            errors = block.compute_errors(fit)
            before[left_out, j] = errors.alone
            if len(members):
                after[members[:, None], left_out, j] = errors.compute_errors_with(amplitudes)
    whole = FoldFit(total, blocks.portions)
    separability, amplitudes_of = np.zeros(len(candidates)), [np.zeros(0)] * len(candidates)
    for number, portion in enumerate(blocks.portions):
        separability[portion.members] = whole.compute_separability(number)
        for member, own in zip(portion.members, whole.fit_amplitudes(number), strict=True):
            amplitudes_of[member] = own
    measured = data.torque_squared()
    return before, [
        Score(candidate, before, after[k], float(separability[k]), amplitudes_of[k], measured)
        for k, candidate in enumerate(candidates)
    ]


def compute_contributions(
    data: Products, base: IndexArray, candidates: Sequence[Candidate], noise: FloatArray
) -> list[FloatArray]:
    """(s, k) of every candidate with k columns: what each stretch adds to the scores of its parameters (Rao's test).

    That is Zᵀρ, each joint in units of its noise, in directions in which ZᵀZ is one: ρ what the model leaves, Z what is
    left of the columns beside it. Their sum over the stretches is zero but for noise where the candidate explains
    nothing, and its square is what the candidate removes where it does.
    """
    blocks = JointBlocks.from_products(data, base, candidates)
    return compute_block_contributions(blocks, blocks.sum_products(noise), len(candidates), noise)


def compute_block_contributions(
    blocks: JointBlocks, total: ProductSums, count: int, noise: FloatArray
) -> list[FloatArray]:
    """The same of `count` candidates from the products that it takes and their sums, where they are at hand."""
    fit = FoldFit(total, blocks.portions)
    sums = np.zeros((blocks.n_stretches, blocks.n_extra))
    for block, sigma in zip(blocks.joints, noise, strict=True):
        sums += block.compute_errors(fit).compute_scores() / sigma**2
    scores = [np.zeros((0, 0))] * count
    for number, portion in enumerate(blocks.portions):
        for member, columns, unit in zip(
            portion.members, portion.columns, fit.compute_unit_directions(number), strict=True
        ):
            scores[member] = sums[:, columns] @ unit
    return scores


def compute_deviations(blocks: JointBlocks, count: int, noise: FloatArray) -> list[FloatArray]:
    """(k,) of every candidate with k columns: the standard deviations of its parameters fitted beside the model.

    From what every stretch adds to the scores: samples of one stretch need not be independent (White 1980, by
    clusters). Infinite where the model and the other columns of the candidate can say the same.
    """
    total = blocks.sum_products(noise)
    scores = compute_block_contributions(blocks, total, count, noise)
    fit = FoldFit(total, blocks.portions)
    more = blocks.n_stretches / max(blocks.n_stretches - 1, 1)
    deviations_of = [np.zeros(0)] * count
    for number, portion in enumerate(blocks.portions):
        for member, unit in zip(portion.members, fit.compute_unit_directions(number), strict=True):
            spread = scores[member] @ unit.T
            deviations_of[member] = np.where(_are_spanned(unit), np.sqrt(more * (spread**2).sum(axis=0)), np.inf)
    return deviations_of


def _are_spanned(unit: FloatArray) -> BoolArray:
    """(k,): which of the parameters the directions `unit` (k, k) span, those of which nothing is left being zero."""
    return np.asarray(np.abs(1.0 - np.einsum("ij,ji->i", unit, np.linalg.pinv(unit))) < _SPANNED)


def compute_fitted_errors(
    data: Products, base: IndexArray, candidate: Candidate, noise: FloatArray
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Squared errors (s, n) of the model and of the model with a candidate, both fitted to all stretches.

    Returns
    -------
    before (s, n), after (s, n), the candidate's separability, its amplitudes
    """
    blocks = JointBlocks.from_products(data, base, [candidate])
    fit = FoldFit(blocks.sum_products(noise), blocks.portions)
    amplitudes = blocks.fit_amplitudes(fit)
    before, after = np.zeros((data.n_stretches, data.n_joints)), np.zeros((data.n_stretches, data.n_joints))
    for j, block in enumerate(blocks.joints):
        errors = block.compute_errors(fit)
        before[:, j], after[:, j] = errors.alone, errors.compute_errors_with(amplitudes)[0]
    return before, after, float(fit.compute_separability(0)[0]), amplitudes.each[0][0]
