"""Score candidates: how much smaller the squared error on the blocks left out becomes with one more effect.

Uses `fold_fit`; which score counts as significant is in `significance`.

All candidates are projected on the complement of the model (Frisch, Waugh and Lovell) within every fold, so that the
model's own parameters adapt to each of them; the squared error of every block of time that was left out follows from
inner products that are computed once. Candidates with equally many columns are scored together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.fold_fit import FoldFit, ProductSums
from dynident.diagnosis.candidates.products_of_scored_pairs import JointBlock, JointBlocks, ProductBlock, RowBlock
from dynident.diagnosis.candidates.time_blocks_and_folds import Products, split_data_folds

# Difference from one below which a direction lies in the span of others.
_SPANNED = 1e-6


@dataclass(frozen=True, eq=False)
class Score:
    """Squared errors on held-out data before and after adding a candidate.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    before : (s, n)
        Squared errors of the model alone, held out, N² m².
    after : (s, n)
        Squared errors with the candidate, held out, N² m².
    separability : float
        Share of the candidate's column that is left beside the model, by norm, the largest of its columns.
    amplitudes : (k,)
        Parameters of the candidate, fitted to all data.
    measured : (n,)
        Sum of the squared torque of every joint.
    """

    candidate: Candidate
    before: FloatArray
    after: FloatArray
    separability: float
    amplitudes: FloatArray
    measured: FloatArray


@dataclass(frozen=True, eq=False)
class FoldedFits:
    """Candidates beside a model that is fitted to all blocks, and without each fold, in some kinds of folds.

    Parameters
    ----------
    blocks : JointBlocks
        Rows or products of all joints.
    whole : FoldFit
        The fit to all blocks.
    fits : tuple of tuple of FoldFit
        The fit without each fold, by kind.
    cells : tuple of ((b,), tuple of int)
        Blocks that are in the same fold in every kind, ascending, and the numbers of these folds.
    """

    blocks: JointBlocks
    whole: FoldFit
    fits: tuple[tuple[FoldFit, ...], ...]
    cells: tuple[tuple[IndexArray, tuple[int, ...]], ...]

    @classmethod
    def from_blocks(cls, data: Products, blocks: JointBlocks, noise: FloatArray, kinds: Sequence[str]) -> FoldedFits:
        """Fit all of them; every row is multiplied once, whatever the number of kinds."""
        folds = [split_data_folds(data, kind) for kind in kinds]
        cells = _cross_folds(folds, blocks.n_blocks)
        sums = [blocks.select_blocks(own).sum_products(noise) for own, _ in cells]
        total = reduce(ProductSums.add, sums)
        fits = []
        for k, each in enumerate(folds):
            # Sums over the training blocks are those of all blocks minus those left out.
            left_out = [
                reduce(ProductSums.add, (own for own, (_, numbers) in zip(sums, cells, strict=True) if numbers[k] == n))
                for n in range(len(each))
            ]
            fits.append(tuple(blocks.fit_model(total.subtract(own)) for own in left_out))
        return cls(blocks, blocks.fit_model(total), tuple(fits), cells)

    def read_cells(self) -> Iterator[tuple[int, IndexArray, JointBlock, tuple[FoldFit, ...]]]:
        """Yield joint, blocks, their rows or products, and the fit without them by kind; rows are read once."""
        for j, joint in enumerate(self.blocks.joints):
            for own, numbers in self.cells:
                fits = tuple(fits[n] for fits, n in zip(self.fits, numbers, strict=True))
                yield j, own, joint.select_blocks(own).hold_rows(), fits


def _cross_folds(
    folds: Sequence[Sequence[IndexArray]], n_blocks: int
) -> tuple[tuple[IndexArray, tuple[int, ...]], ...]:
    """Return the blocks that are in the same fold in every kind, and the numbers of these folds."""
    numbers = np.zeros((len(folds), n_blocks), dtype=np.intp)
    for own, each in zip(numbers, folds, strict=True):
        for k, fold in enumerate(each):
            own[fold] = k
    cells, member = np.unique(numbers, axis=1, return_inverse=True)
    return tuple((np.flatnonzero(member.ravel() == k), tuple(cell.tolist())) for k, cell in enumerate(cells.T))


def compute_held_out_errors(data: Products, base: IndexArray, noise: FloatArray, kind: str) -> FloatArray:
    """Return the squared error (s, n) of the model alone in every block, fitted without the fold of the block."""
    return score_candidates(data, base, (), noise, kind)[0]


def score_candidates(
    data: Products, base: IndexArray, candidates: Sequence[Candidate], noise: FloatArray, kind: str
) -> tuple[FloatArray, list[Score]]:
    """Score every candidate beside a model.

    Returns
    -------
    tuple of (s, n), list of Score
        Squared errors of the model alone, and a score for every candidate.
    """
    fits = FoldedFits.from_blocks(data, JointBlocks.from_products(data, base, candidates), noise, (kind,))
    ((scored,), _) = score_folds(data, fits, candidates, noise)
    return scored


def score_folds(
    data: Products, fits: FoldedFits, candidates: Sequence[Candidate], noise: FloatArray
) -> tuple[list[tuple[FloatArray, list[Score]]], list[FloatArray]]:
    """Score every candidate in some kinds of folds, and by the scores of its parameters.

    Returns
    -------
    tuple of list, list of (s, k)
        What `score_candidates` returns, by kind; and what `compute_contributions` returns.
    """
    s, n, blocks = data.n_blocks, data.n_joints, fits.blocks
    before = [np.zeros((s, n)) for _ in fits.fits]
    after = [np.zeros((len(candidates), s, n)) for _ in fits.fits]
    sums = np.zeros((s, blocks.n_extra))
    # Candidates are scored by portion; these are their numbers in that order.
    members = np.array([k for portion in blocks.portions for k in portion.members], dtype=np.intp)
    amplitudes_of_fit = {fit: blocks.fit_amplitudes(fit) for each in fits.fits for fit in each}
    for j, own, block, left_out in fits.read_cells():
        if len(members):
            sums[own] += block.compute_errors(fits.whole).compute_scores() / noise[j] ** 2
        for k, fit in enumerate(left_out):
            errors = block.compute_errors(fit)
            before[k][own, j] = errors.alone
            if len(members):
                after[k][members[:, None], own, j] = errors.compute_errors_with(amplitudes_of_fit[fit])
    # What is reported of a candidate comes from all data; only its errors are held out.
    separability, amplitudes = np.zeros(len(candidates)), [np.zeros(0)] * len(candidates)
    for number, portion in enumerate(blocks.portions):
        separability[portion.members] = fits.whole.compute_separability(number)
        for member, values in zip(portion.members, fits.whole.fit_amplitudes(number), strict=True):
            amplitudes[member] = values
    measured = data.torque_squared()
    scores = [
        [
            Score(candidate, alone, each[k], float(separability[k]), amplitudes[k], measured)
            for k, candidate in enumerate(candidates)
        ]
        for alone, each in zip(before, after, strict=True)
    ]
    return list(zip(before, scores, strict=True)), _distribute_scores(fits.whole, sums, len(candidates))


def compute_contributions(
    data: Products, base: IndexArray, candidates: Sequence[Candidate], noise: FloatArray
) -> list[FloatArray]:
    """Return (s, k) for every candidate: what each block adds to the scores of its k parameters (Rao's test).

    That is Zᵀρ, each joint in units of its noise, in directions in which ZᵀZ is one: ρ what the model leaves, Z what is
    left of the columns beside it. Their sum over the blocks is zero but for noise where the candidate explains
    nothing, and its square is what the candidate removes where it does.
    """
    blocks = JointBlocks.from_products(data, base, candidates)
    return _compute_contributions(blocks, blocks.fit_model(blocks.sum_products(noise)), len(candidates), noise)


def _compute_contributions(blocks: JointBlocks, fit: FoldFit, count: int, noise: FloatArray) -> list[FloatArray]:
    """Return the same as `compute_contributions` for `count` candidates, from blocks and the fit to them."""
    sums = np.zeros((blocks.n_blocks, blocks.n_extra))
    for block, sigma in zip(blocks.joints, noise, strict=True):
        sums += block.compute_errors(fit).compute_scores() / sigma**2
    return _distribute_scores(fit, sums, count)


def _distribute_scores(fit: FoldFit, sums: FloatArray, count: int) -> list[FloatArray]:
    """Return the scores (s, k) of each candidate in unit directions, from those of all columns (s, c)."""
    scores = [np.zeros((0, 0))] * count
    for number, portion in enumerate(fit.portions):
        for member, columns, unit in zip(
            portion.members, portion.columns, fit.compute_unit_directions(number), strict=True
        ):
            scores[member] = sums[:, columns] @ unit
    return scores


def compute_deviations(blocks: JointBlocks, count: int, noise: FloatArray) -> list[FloatArray]:
    """Return (k,) for every candidate: the standard deviations of its k parameters, fitted beside the model.

    From what every block adds to the scores: samples of one block need not be independent (White 1980, by
    clusters). Infinite where the model and the other columns of the candidate can say the same.
    """
    fit = blocks.fit_model(blocks.sum_products(noise))
    scores = _compute_contributions(blocks, fit, count, noise)
    # The correction for few clusters, m / (m - 1).
    more = blocks.n_blocks / max(blocks.n_blocks - 1, 1)
    deviations_of = [np.zeros(0)] * count
    for number, portion in enumerate(blocks.portions):
        for member, unit in zip(portion.members, fit.compute_unit_directions(number), strict=True):
            # What each block moves the parameters by; the sum of squares over the blocks is their variance.
            spread = scores[member] @ unit.T
            deviations_of[member] = np.where(_are_spanned(unit), np.sqrt(more * (spread**2).sum(axis=0)), np.inf)
    return deviations_of


def _are_spanned(unit: FloatArray) -> BoolArray:
    """Return which parameters (k,) the directions `unit` (k, k) span; directions of which nothing is left are zero."""
    return np.asarray(np.abs(1.0 - np.einsum("ij,ji->i", unit, np.linalg.pinv(unit))) < _SPANNED)


def compute_fitted_errors(
    data: Products, base: IndexArray, candidate: Candidate, noise: FloatArray
) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Return the squared errors of the model and of the model with a candidate, both fitted to all blocks.

    Returns
    -------
    tuple of (s, n), (s, n), float, (k,)
        Errors before and after, separability and amplitudes of the candidate.
    """
    blocks = JointBlocks.from_products(data, base, [candidate])
    fit = blocks.fit_model(blocks.sum_products(noise))
    amplitudes = blocks.fit_amplitudes(fit)
    before, after = np.zeros((data.n_blocks, data.n_joints)), np.zeros((data.n_blocks, data.n_joints))
    for j, block in enumerate(blocks.joints):
        errors = block.compute_errors(fit)
        before[:, j], after[:, j] = errors.alone, errors.compute_errors_with(amplitudes)[0]
    return before, after, float(fit.compute_separability(0)[0]), amplitudes.each[0][0]


def compute_block_products(block: JointBlock, fit: FoldFit) -> tuple[FloatArray, ...]:
    """Return ZᵀZ of every candidate on one joint, block by block; Z = X - W P is what the model leaves of its columns.

    Returns
    -------
    tuple of (g, s, k, k)
        One array for each portion of candidates with k columns each.
    """
    projection = fit.projection[block.have]
    if isinstance(block, RowBlock):
        has = np.flatnonzero(block.place < block.n_columns)
        # Nothing is left of columns that neither the joint nor the model's parameters on it have a share in.
        is_shared = np.asarray(projection.any(axis=0))
        is_shared[has] = True
        shared = np.flatnonzero(is_shared)
        products = [np.zeros((len(own.members), len(block.blocks), own.width, own.width)) for own in fit.portions]
        for rows in block.read_rows():
            rest = np.zeros((len(is_shared), rows.w.shape[1]))
            rest[shared] = -(projection[:, shared].T @ rows.w)
            rest[has] += rows.x[block.place[has]]
            for portion, own_products in zip(fit.portions, products, strict=True):
                members = np.flatnonzero(is_shared[portion.columns].any(axis=1))
                own = rest[portion.columns[members]]
                pairs = own[:, :, None, :] * own[:, None, :, :]
                own_products[members[:, None], np.arange(rows.blocks.start, rows.blocks.stop)] = rows.add_up(
                    pairs
                ).transpose(0, 3, 1, 2)
        return tuple(products)
    assert isinstance(block, ProductBlock)
    products = []
    for portion, pairs in zip(fit.portions, block.pairs, strict=True):
        shift = projection[:, portion.columns].transpose(1, 0, 2)
        # (XᵀW) P, column by column of the candidate.
        mixed = np.einsum("sbgk,gbl->sgkl", block.wx[:, :, block.place[portion.columns]], shift)
        inner = np.einsum("gbk,sbc,gcl->sgkl", shift, block.ww, shift, optimize=True)
        whole = pairs - mixed - mixed.transpose(0, 1, 3, 2) + inner
        products.append(whole.transpose(1, 0, 2, 3))
    return tuple(products)
