"""Score candidates: how much smaller the squared error on the blocks left out becomes with one more effect.

Uses `fold_fit`; which score counts as significant is in `significance`.

All candidates are projected on the complement of the model (Frisch, Waugh and Lovell) within every fold, so that the
model's own parameters adapt to each of them; the squared error of every block of time that was left out follows from
inner products that are computed once. Candidates with equally many columns are scored together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.fold_fit import Batch, FoldFits, ProductSums, list_extra_columns, split_batches
from dynident.diagnosis.candidates.products_of_scored_pairs import (
    JointBlock,
    JointErrors,
    ProductBlock,
    RowBlock,
)
from dynident.diagnosis.candidates.time_blocks_and_folds import BlockSets, Products, RowStack
from dynident.estimation import PriorInformation
from dynident.parallel import map_in_threads
from dynident.progress import Progress

# Joints that are scored at a time: each holds a piece of its rows, and their errors with every candidate.
_MOST_JOINTS = 8
# Difference from one below which a direction lies in the span of others.
_SPANNED = 1e-6


@dataclass(frozen=True, eq=False)
class JointBlocks:
    """Rows or products of all joints, for a model and candidates beside it.

    Parameters
    ----------
    base : (b,)
        Columns of the model.
    n_extra : int
        Number of columns c of the candidates.
    n_blocks : int
        Number of blocks.
    portions : tuple of Batch
        The candidates, by number of columns.
    joints : tuple of JointBlock
        Rows or products of each joint.
    sets : BlockSets
        The folds in which candidates are scored.
    known : PriorInformation or None
        What is known of the model's parameters beside the data.
    """

    base: IndexArray
    n_extra: int
    n_blocks: int
    portions: tuple[Batch, ...]
    joints: tuple[JointBlock, ...]
    sets: BlockSets
    known: PriorInformation | None

    @classmethod
    def from_products(cls, data: Products, base: IndexArray, candidates: Sequence[Candidate]) -> JointBlocks:
        """Take what is needed to score candidates beside a model."""
        extra = list_extra_columns(candidates)
        portions = split_batches(candidates, extra)
        joints = tuple(_build_block(data, joint, base, extra, portions) for joint in range(data.n_joints))
        return cls(np.asarray(base, dtype=np.intp), len(extra), data.n_blocks, portions, joints, data.sets, data.known)

    def fit_sets(self, noise: FloatArray, sets: BlockSets | None = None, left_out: Sequence[int] = ()) -> FoldFits:
        """Fit the model to all blocks, and without each of some sets of blocks, and to what is known beside them.

        Parameters
        ----------
        noise : (n,)
            Standard deviation of the noise of each joint, N m or N.
        sets : BlockSets, optional
            Sets of blocks; by default those of the folds in which candidates are scored.
        left_out : sequence of int
            Numbers of the sets.
        """
        sums = self.sum_sets(noise, sets or self.sets).leave_out(np.array([0, *left_out], dtype=np.intp))
        return FoldFits(sums if self.known is None else sums.add_known(self.known, self.base), self.portions)

    def sum_sets(self, noise: FloatArray, sets: BlockSets) -> ProductSums:
        """Return the sums over all blocks, and over each of some sets, of all joints in units of their noise (n,)."""
        f, b, c = len(sets.members), len(self.base), self.n_extra
        ww, xw, wy, xy = np.zeros((f, b, b)), np.zeros((f, c, b)), np.zeros((f, b)), np.zeros((f, c))
        within = tuple(np.zeros((f, *portion.columns.shape, portion.width)) for portion in self.portions)
        for block, sigma in zip(self.joints, noise, strict=True):
            products, own_pairs = block.sum_sets(sets)
            # Rows of a joint count by the inverse of the variance of its noise, as in the fit of the model.
            products /= sigma**2
            w, have = len(block.have), block.have
            has = np.flatnonzero(block.place < products.shape[2] - w - 1)
            ww[:, have[:, None], have] += products[:, :w, :w]
            xw[:, has[:, None], have] += products[:, :w, w + 1 :].transpose(0, 2, 1)
            wy[:, have] += products[:, :w, w]
            xy[:, has] += products[:, w, w + 1 :]
            for whole, own in zip(within, own_pairs, strict=True):
                whole += own / sigma**2
        return ProductSums(ww, xw, wy, xy, within)


def _build_block(
    data: Products, joint: int, base: IndexArray, extra: IndexArray, portions: Sequence[Batch]
) -> JointBlock:
    # Rows are used as they are where all of them are at hand; one kind in products makes products of all.
    if all(isinstance(stack, RowStack) for stack in data.stacks[joint]):
        return RowBlock.from_products(data, joint, base, extra, portions)
    return ProductBlock.from_products(data, joint, base, extra, portions)


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
    fits : FoldFits
        The fit to all blocks, and those without each fold.
    numbers : tuple of (s,)
        The fit that each block has: that to all blocks, and by kind that without its fold.
    """

    blocks: JointBlocks
    fits: FoldFits
    numbers: tuple[IndexArray, ...]

    @classmethod
    def from_blocks(cls, data: Products, blocks: JointBlocks, noise: FloatArray, kinds: Sequence[str]) -> FoldedFits:
        """Fit all of them."""
        sets = data.sets if set(kinds) <= set(data.sets.kinds) else data.number_sets(kinds)
        numbers, left_out = [np.zeros(data.n_blocks, dtype=np.intp)], list[int]()
        for kind in kinds:
            numbers.append(sets.folds[sets.kinds.index(kind)] + 1 + len(left_out))
            left_out += sets.list_folds(kind)
        return cls(blocks, blocks.fit_sets(noise, sets, left_out), tuple(numbers))

    def read_errors(self, joint: int) -> Iterator[list[JointErrors]]:
        """Yield errors of a joint in the fit to all blocks and by kind of folds; they add up."""
        for piece in self.blocks.joints[joint].read_pieces():
            yield [piece.compute_errors(self.fits, own) for own in self.numbers]


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
    ((scored,), _) = score_folds(data, fits, candidates, noise, by_parameters=False)
    return scored


def score_folds(
    data: Products, fits: FoldedFits, candidates: Sequence[Candidate], noise: FloatArray, *, by_parameters: bool
) -> tuple[list[tuple[FloatArray, list[Score]]], list[FloatArray]]:
    """Score every candidate in some kinds of folds and, where asked for, by the scores of its parameters (Rao's test).

    Returns
    -------
    tuple of list, list of (s, k)
        What `score_candidates` returns, by kind; and what each block adds to the scores of the k parameters of every
        candidate, or nothing. That is Zᵀρ, each joint in units of its noise, in directions in which ZᵀZ is one: ρ what
        the model leaves, Z what is left of the columns beside it. Their sum over the blocks is zero but for noise where
        the candidate explains nothing, and its square is what the candidate removes where it does.
    """
    s, n, portions, kinds = data.n_blocks, data.n_joints, fits.blocks.portions, len(fits.numbers) - 1
    before, after = np.zeros((kinds, s, n)), np.zeros((kinds, len(candidates), s, n))
    # Candidates are scored by portion; these are their numbers in that order.
    members = np.array([k for portion in portions for k in portion.members], dtype=np.intp)

    def score_joint(j: int, _: Progress) -> FloatArray:
        """Fill in the errors of a joint; return what it adds to the scores of the columns (s, c)."""
        sums = np.zeros((s, fits.blocks.n_extra))
        for fitted, *held_out in fits.read_errors(j):
            if by_parameters and len(members):
                sums += fitted.compute_scores() / noise[j] ** 2
            for k, errors in enumerate(held_out):
                before[k, :, j] += errors.alone
                if len(members):
                    after[k, members, :, j] += errors.compute_errors_with()
        return sums

    sizes = len(candidates) * data.counts.sum(axis=0)
    sums = sum(
        map_in_threads(score_joint, range(n), sizes.tolist(), most=_MOST_JOINTS), np.zeros((s, fits.blocks.n_extra))
    )
    # What is reported of a candidate comes from all data; only its errors are held out.
    separability, amplitudes = np.zeros(len(candidates)), [np.zeros(0)] * len(candidates)
    for number, portion in enumerate(portions):
        separability[portion.members] = fits.fits.compute_separability(number)
        for member, values in zip(portion.members, fits.fits.amplitudes[number][0], strict=True):
            amplitudes[member] = values
    measured = data.torque_squared()
    scores = [
        [
            Score(candidate, alone, each[k], float(separability[k]), amplitudes[k], measured)
            for k, candidate in enumerate(candidates)
        ]
        for alone, each in zip(before, after, strict=True)
    ]
    contributions = _distribute_scores(fits.fits, sums) if by_parameters else []
    return list(zip(before, scores, strict=True)), contributions


def _distribute_scores(fit: FoldFits, sums: FloatArray) -> list[FloatArray]:
    """Return the scores (s, k) of each candidate in unit directions, from those of all columns (s, c)."""
    scores = [np.zeros((0, 0))] * sum(len(portion.members) for portion in fit.portions)
    for number, portion in enumerate(fit.portions):
        for member, columns, unit in zip(
            portion.members, portion.columns, fit.compute_unit_directions(number), strict=True
        ):
            scores[member] = sums[:, columns] @ unit
    return scores


def compute_deviations(
    data: Products, base: IndexArray, candidates: Sequence[Candidate], noise: FloatArray
) -> list[FloatArray]:
    """Return (k,) for every candidate: the standard deviations of its k parameters, fitted beside the model.

    From what every block adds to the scores: samples of one block need not be independent (White 1980, by
    clusters). Infinite where the model and the other columns of the candidate can say the same.
    """
    fits = FoldedFits.from_blocks(data, JointBlocks.from_products(data, base, candidates), noise, ())
    _, scores = score_folds(data, fits, candidates, noise, by_parameters=True)
    # The correction for few clusters, m / (m - 1).
    more = data.n_blocks / max(data.n_blocks - 1, 1)
    deviations_of = [np.zeros(0)] * len(scores)
    for number, portion in enumerate(fits.blocks.portions):
        for member, unit in zip(portion.members, fits.fits.compute_unit_directions(number), strict=True):
            # What each block moves the parameters by; the sum of squares over the blocks is their variance.
            spread = scores[member] @ unit.T
            deviations_of[member] = np.where(_are_spanned(unit), np.sqrt(more * (spread**2).sum(axis=0)), np.inf)
    return deviations_of


def _are_spanned(unit: FloatArray) -> BoolArray:
    """Return which parameters (k,) the directions `unit` (k, k) span; directions of which nothing is left are zero."""
    return np.asarray(np.abs(1.0 - np.einsum("ij,ji->i", unit, np.linalg.pinv(unit))) < _SPANNED)


def score_fitted(data: Products, base: IndexArray, candidate: Candidate, noise: FloatArray) -> Score:
    """Return the score of a candidate with the errors of the model, and of the model with it, fitted to all blocks."""
    fits = FoldedFits.from_blocks(data, JointBlocks.from_products(data, base, [candidate]), noise, ())
    ((_, (score,)),), _ = score_folds(
        data, replace(fits, numbers=2 * fits.numbers), [candidate], noise, by_parameters=False
    )
    return score
