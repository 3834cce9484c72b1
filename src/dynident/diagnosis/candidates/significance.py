"""Decide when a gain on held-out data is significant, and when two explanations count as equal.

Familywise sign-flip test over all candidates, 2,000 draws; the default level is `ALPHA`.

One test covers all candidates together: could a gain as even as this be chance, with so many tried? A candidate that
explains nothing gains and loses alike on blocks of time that it was not fitted to: flipping the signs of whole blocks
changes nothing about it. The same flips for all candidates keep how they resemble each other, so the largest value over
all of them tells what the best of so many reaches by chance (Westfall and Young 1993).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.special import stdtrit

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.held_out_scores import Score
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.diagnosis_request import DEFAULT_SIGNIFICANCE
from dynident.diagnosis.residuals.failure_map_and_unknown_patterns import compute_median_error
from dynident.effects import CATALOGUE
from dynident.estimation.residual_errors import compute_evenness, compute_signed_roots, compute_t

DRAWS = 2000
"""Turns of the signs: a p of 0.01 is then known to within a fifth of itself."""

_SEED = 20
# Candidates at once: their turned sums stay in the cache.
_TOGETHER = 64
_TINY = float(np.finfo(float).tiny)


@dataclass(frozen=True)
class FamilywiseLevels:
    """What the two statistics of a candidate have to exceed to pass the family-wise test.

    Parameters
    ----------
    gains : float
        Least t of the signed roots of its gains (`compute_evenness`).
    scores : float
        Least size of its scores, on the scale of `standardise_size`.
    """

    gains: float
    scores: float


def run_familywise_test(
    gains: FloatArray, draws: Sequence[FloatArray], level: float | None = None
) -> tuple[FloatArray, FamilywiseLevels]:
    """Return how often the best of all candidates would look as good by chance as each of them does.

    Of two statistics the one that says more, at half the level each (Bonferroni): the scores see what little a single
    parameter explains, the evenness of gains an effect of many parameters in few blocks.

    Parameters
    ----------
    gains : (c, s)
        Gain of each candidate in each block that it was not fitted to, in squared units of the noise.
    draws : sequence of (draws,)
        Sizes of the scores of each candidate (`draw_scores`).
    level : float, optional
        Largest p-value of a finding; by default that of tests that no request sets.

    Returns
    -------
    (c,), FamilywiseLevels
        p-value of each candidate, and what the statistics have to exceed for a p-value of `level`.
    """
    count, n_blocks = gains.shape
    # With a single block there is nothing whose signs could be changed: nothing is significant.
    if not count or n_blocks < 2:
        return np.ones(count), FamilywiseLevels(np.inf, np.inf)
    by_gains, largest_gains = _test_gains(gains, _draw_signs(n_blocks))
    sizes = np.array(draws)
    largest_scores = sizes.max(axis=0)
    by_scores = _compute_share_reached(sizes[:, 0], largest_scores)
    # Half of the level for each statistic.
    quantile = 1.0 - (ALPHA if level is None else level) / 2.0
    levels = FamilywiseLevels(float(np.quantile(largest_gains, quantile)), float(np.quantile(largest_scores, quantile)))
    return np.asarray(np.minimum(1.0, 2.0 * np.minimum(by_gains, by_scores))), levels


def compute_single_p(gains: FloatArray) -> float:
    """Return how often chance would look as good as the gains (s,) of one candidate, with nothing else tried."""
    return float(_test_gains(gains[None], _draw_signs(len(gains)))[0][0])


@lru_cache(maxsize=2)
def _draw_signs(n_blocks: int) -> FloatArray:
    """Return random signs (draws, s), of which the first row changes none."""
    # A fixed seed: the same data give the same p-values. The same signs for all candidates: those that resemble each
    # other stay alike in every draw.
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], size=(DRAWS, n_blocks))
    # The observed signs count as one of the draws, so that no p is zero.
    signs[0] = 1.0
    return signs


def _test_gains(gains: FloatArray, signs: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (c,): the share of draws in which any candidate gains as evenly; and the most even of each draw."""
    values = compute_signed_roots(gains)
    n_blocks = values.shape[1]
    mean = signs @ values.T / n_blocks
    # Signs change the mean of the values and leave their squares: the variance follows without another product.
    variance = np.maximum((values**2).mean(axis=1) - mean**2, _TINY) * n_blocks / (n_blocks - 1)
    largest = (mean / np.sqrt(variance / n_blocks)).max(axis=1)
    return _compute_share_reached(compute_evenness(gains), largest), largest


def draw_scores(scores: Sequence[FloatArray]) -> list[FloatArray]:
    """Return (draws,) for every candidate: the size of the sum of its scores with the signs of blocks drawn anew.

    They are on one scale whatever the number of parameters, and the first draw is what was observed.

    Parameters
    ----------
    scores : sequence of (s, k)
        What each block adds to the scores of the k parameters of a candidate (`score_folds`).
    """
    sizes = [np.zeros(0)] * len(scores)
    # Candidates of equally many parameters are handled together, some at a time.
    for width in {each.shape[1] for each in scores}:
        members = [k for k, each in enumerate(scores) if each.shape[1] == width]
        for first in range(0, len(members), _TOGETHER):
            batch = members[first : first + _TOGETHER]
            values = _standardise_scores(np.array([scores[k] for k in batch]), _draw_signs(len(scores[0])))
            for k, own in zip(batch, values.T, strict=True):
                sizes[k] = own.copy()
    return sizes


def _compute_share_reached(own: FloatArray, largest: FloatArray) -> FloatArray:
    # The tolerance keeps the observed value, which is among the draws, from missing itself by rounding.
    return np.asarray((len(largest) - np.searchsorted(np.sort(largest), own - 1e-9, side="left")) / len(largest))


def _standardise_scores(scores: FloatArray, signs: FloatArray) -> FloatArray:
    """Return (draws, g): the size of the sums of scores (g, s, k) with random signs, on one scale whatever k."""
    g, s, k = scores.shape
    sums = (signs @ scores.transpose(1, 0, 2).reshape(s, g * k)).reshape(-1, g, k)
    return standardise_size((sums**2).sum(axis=2), scores.transpose(0, 2, 1) @ scores)


def standardise_size(squares: FloatArray, spread: FloatArray) -> FloatArray:
    """Return squared sums of scores as values that are about normal, whatever the number of parameters.

    They are about the squares of so many normal variables as agree with their first two moments (Satterthwaite 1946);
    the cube root of that is about normal (Wilson and Hilferty 1931).
    """
    mean = np.einsum("gkk->g", spread)
    # Candidates for which only their gains may speak have scores of zero.
    silent = mean <= _TINY
    mean = np.where(silent, 1.0, mean)
    freedom = np.where(silent, 1.0, mean**2 / np.where(silent, 1.0, (spread**2).sum(axis=(1, 2))))
    return np.asarray((np.cbrt(squares / mean) - (1.0 - 2.0 / (9.0 * freedom))) / np.sqrt(2.0 / (9.0 * freedom)))


ALPHA = DEFAULT_SIGNIFICANCE
"""The level of tests that no request sets."""


def compute_least_t(blocks: int, level: float) -> float:
    """Return the t of a gain over so many blocks that chance reaches with a probability, for one candidate alone."""
    return float(stdtrit(blocks - 1, 1.0 - level))


@dataclass(frozen=True, eq=False)
class ScoredCandidate:
    """A candidate with its score in interleaved and contiguous folds.

    Parameters
    ----------
    candidate : Candidate
        The candidate.
    joints : tuple of int
        Indices of the joints that it acts on.
    before : (s, n)
        Squared errors of the model alone, held out, N² m².
    after : (s, n)
        Squared errors with the candidate, held out, N² m².
    drop : float
        Share of the squared error on left-out blocks that it removes, the smaller of the two kinds of folds: on the
        joint where that share is largest for an effect of one joint or of the whole robot, on all its joints for a
        group.
    t : float
        t of the roots of the gains over the blocks.
    gains : (s,)
        Drop of each block in units of the noise, over all joints, the kinds of folds averaged.
    separability : float
        Share of its column that is left beside the model, by norm.
    amplitudes : (k,)
        Its parameters, fitted to all data.
    share_improved : float
        Share of the blocks that it improves.
    measured : (n,)
        Sum of the squared torque of each joint.
    after_weighted : (s,)
        What is left on its joints, in units of the noise.
    p : float
        p-value of the family-wise test among all candidates of its round.
    """

    candidate: Candidate
    joints: tuple[int, ...]
    before: FloatArray
    after: FloatArray
    drop: float
    t: float
    gains: FloatArray
    separability: float
    amplitudes: FloatArray
    share_improved: float
    measured: FloatArray
    after_weighted: FloatArray
    p: float = 1.0

    @property
    def n_columns(self) -> int:
        """Number of the candidate's amplitudes."""
        return len(self.candidate.columns)

    @property
    def complexity(self) -> int:
        """Number of parameters of the effect on so many joints, whether or not each of them acts on this robot."""
        effect = CATALOGUE.get(self.candidate.effect)
        each = len(effect.parameters) if effect else self.n_columns
        return each * max(1, len(self.candidate.joints))

    @property
    def freedom(self) -> int:
        """The same with the shape constants that the data chose: the best of forty springs is no plain offset."""
        effect = CATALOGUE.get(self.candidate.effect)
        return self.complexity + (sum(spec.refined is not None for spec in effect.shapes) if effect else 0)

    @property
    def total_gain(self) -> float:
        """What the candidate removes in all, in units of the noise."""
        return float(self.gains.sum())

    @property
    def reported_joints(self) -> list[int]:
        """Joints that errors are told of: those named; of an effect of the whole robot all that it acts on."""
        named = len(self.candidate.joints)
        if not named or named == len(self.joints):
            return list(self.joints)
        # An effect of one joint that acts on others too: the joint that it helps most.
        removed = (self.before - self.after).sum(axis=0) / np.maximum(self.before.sum(axis=0), _TINY)
        return [max(self.joints, key=lambda j: float(removed[j]))]

    @property
    def error_drop(self) -> float:
        """Share of the error on left-out blocks, in N m, that it removes on the joints that it is told of."""
        joints = self.reported_joints
        before, after = float(self.before[:, joints].sum()), float(self.after[:, joints].sum())
        return 1.0 - float(np.sqrt(after / before)) if before > 0 else 0.0


@dataclass(frozen=True, eq=False)
class BaselineErrors:
    """What the model alone leaves in one kind of folds.

    Parameters
    ----------
    squares : (s, n)
        Squared errors of the model alone, held out, N² m².
    weight : (n,)
        Inverse of the squared noise of each joint.
    factor : (s,)
        Weight of each block: one block with half of all the error must not decide, so its gain counts up to three times
        a usual one's.
    """

    squares: FloatArray
    weight: FloatArray
    factor: FloatArray

    @classmethod
    def from_errors(cls, before: FloatArray, noise: FloatArray) -> BaselineErrors:
        """Build them from squared errors (s, n) and the noise (n,).

        Parameters
        ----------
        before : (s, n)
            Squared errors of the model alone, held out, N² m².
        noise : (n,)
            Standard deviation of the noise of each joint, N m or N.
        """
        weight = 1.0 / noise**2
        whole = before @ weight
        most = RULES.most_of_block * compute_median_error(whole)
        return cls(before, weight, np.minimum(1.0, most / np.maximum(whole, 1e-300)))

    @cached_property
    def most(self) -> FloatArray:
        """The most (s, n) that counts of the errors with a candidate: no loss counts for more than there was."""
        return 2.0 * self.squares

    @cached_property
    def sums(self) -> FloatArray:
        """Errors of each joint (n,) over all blocks, in units of the noise."""
        return np.asarray(self.factor @ self.squares * self.weight)


def combine_scores(
    scores: Sequence[Sequence[Score]], joints: Sequence[tuple[int, ...]], noise: FloatArray
) -> list[ScoredCandidate]:
    """Combine the scores of candidates in the two kinds of folds.

    Parameters
    ----------
    scores : sequence of sequence of Score
        For each kind of folds, the scores of all candidates.
    joints : sequence of tuple of int
        Indices of the joints that each candidate acts on.
    noise : (n,)
        Standard deviation of the noise of each joint, N m or N.

    Returns
    -------
    list of ScoredCandidate
        The candidates with what both kinds say.
    """
    if not joints:
        return []
    bars = [BaselineErrors.from_errors(own[0].before, noise) for own in scores]
    # Nothing can gain more than there was; nor does a loss count for more, where a fold leaves out what decides.
    errors = [np.minimum([score.after for score in own], bar.most) for own, bar in zip(scores, bars, strict=True)]
    gains = [(bar.squares - own) * bar.weight for own, bar in zip(errors, bars, strict=True)]
    removed = [np.einsum("s,csn->cn", bar.factor, own) for own, bar in zip(gains, bars, strict=True)]
    mean_gains = _average_arrays([own.sum(axis=2) * bar.factor for own, bar in zip(gains, bars, strict=True)])
    before, after = _average_arrays([bar.squares for bar in bars]), _average_arrays(errors)
    t, improved = compute_evenness(mean_gains), (mean_gains > 0).mean(axis=1)
    acts = np.zeros((len(joints), len(noise)))
    for own_acts, own_joints in zip(acts, joints, strict=True):
        own_acts[list(own_joints)] = 1.0
    after_weighted = np.einsum("csn,cn->cs", after, acts * bars[0].weight)
    # The smaller of both kinds of folds: a finding has to hold whichever blocks are left out together.
    drops = np.min([own / np.maximum(bar.sums, _TINY) for own, bar in zip(removed, bars, strict=True)], axis=0)
    largest = np.where(acts > 0.0, drops, -np.inf).max(axis=1)
    together = np.min(
        [(own * acts).sum(axis=1) / np.maximum(acts @ bar.sums, _TINY) for own, bar in zip(removed, bars, strict=True)],
        axis=0,
    )
    return [
        ScoredCandidate(
            candidate=score.candidate,
            joints=own_joints,
            before=before,
            # Copies, since a candidate that lasts would keep the arrays of all that were scored with it.
            after=after[k].copy(),
            # An effect that acts on several joints may help one of them alone; a group of single ones is judged by all.
            drop=float((largest if len(score.candidate.joints) < 2 and own_joints else together)[k]),
            t=float(t[k]),
            gains=mean_gains[k].copy(),
            separability=score.separability,
            amplitudes=score.amplitudes,
            share_improved=float(improved[k]),
            measured=score.measured,
            after_weighted=after_weighted[k].copy(),
        )
        for k, (score, own_joints) in enumerate(zip(scores[0], joints, strict=True))
    ]


def _average_arrays(values: Sequence[FloatArray]) -> FloatArray:
    """Average a few large arrays without stacking them."""
    first, *others = values
    return np.asarray(sum(others, first) / len(values))


def are_indistinguishable(best: ScoredCandidate, other: ScoredCandidate) -> bool:
    """Return whether the blocks do not tell two explanations apart: mean difference below its standard error.

    Parameters
    ----------
    best, other : ScoredCandidate
        The candidates to compare, scored on the same rows.
    """
    difference = best.gains - other.gains
    return abs(compute_t(difference)) < 1.0 or np.allclose(difference, 0.0)


def select_simplest(judged: Sequence[ScoredCandidate]) -> tuple[ScoredCandidate, tuple[ScoredCandidate, ...]]:
    """Select the simplest candidate that the best one does not beat by a finding, and those that are its equals.

    Fewer columns are preferred as long as what more of them gain would not pass the gate itself; among equally many
    the larger gain decides.
    """
    ordered = sorted(judged, key=lambda scored: -scored.total_gain)
    best = ordered[0]
    plain = [scored for scored in ordered if scored is best or not _is_worth_complexity(best, scored)]
    slimmest = min(scored.complexity for scored in plain)
    slim = [scored for scored in plain if scored.complexity == slimmest]
    # Of those on other joints that gain as much, the one whose gain is most even: on a wrong joint gains are by chance.
    elsewhere = [scored for scored in slim if scored.candidate.joints != slim[0].candidate.joints]
    chosen = max(
        [slim[0], *(scored for scored in elsewhere if are_indistinguishable(slim[0], scored))], key=lambda i: i.t
    )
    return chosen, tuple(scored for scored in ordered if scored is not chosen and are_indistinguishable(chosen, scored))


def _is_worth_complexity(best: ScoredCandidate, simpler: ScoredCandidate) -> bool:
    """Return whether the more complex candidate removes enough more of the error, often enough."""
    return simpler.complexity >= best.complexity or has_larger_gain(best, simpler)


def has_larger_gain(best: ScoredCandidate, simpler: ScoredCandidate) -> bool:
    """Return whether a candidate removes so much more of the error than another that it may be more complex.

    Parameters
    ----------
    best, simpler : ScoredCandidate
        The candidate in question, and the one that it is compared with.
    """
    difference = best.gains - simpler.gains
    remaining = float(simpler.after_weighted.sum())
    more = float(difference.sum())
    # Much more is decided by size alone; little more has to be large against what is left, and even over the blocks.
    if more >= RULES.more_for_parameters * best.total_gain:
        return True
    return more >= RULES.least_drop * remaining and compute_t(difference) >= RULES.clear_t
