"""One test for all candidates together: could a gain as even as this be chance, with so many tried?

A candidate that explains nothing gains and loses alike on stretches of time that it was not fitted to: turning the
signs of whole stretches changes nothing about it. The same turns for all candidates keep how they resemble each other,
so the largest value over all of them tells what the best of so many reaches by chance (Westfall and Young 1993).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray

DRAWS = 2000
"""Turns of the signs: a p of 0.01 is then known to within a fifth of itself."""

_SEED = 20
# Candidates at once: their turned sums stay in the cache.
_TOGETHER = 64


def compute_familywise_p(gains: FloatArray, scores: Sequence[FloatArray]) -> FloatArray:
    """Return how often the best of all candidates would look as good by chance as each of them does.

    Of two statistics the one that says more, at half the level each (Bonferroni): the scores see what little a single
    parameter explains, the evenness of gains an effect of many parameters in few blocks.

    Parameters
    ----------
    gains : (c, s)
        Gain of each candidate in each block that it was not fitted to, in squared units of the noise.
    scores : sequence of (s, k)
        What each block adds to the scores of the k parameters of a candidate (`compute_contributions`).

    Returns
    -------
    (c,)
        p-value of each candidate.
    """
    count, n_stretches = gains.shape
    # With a single block there is nothing whose signs could be changed: nothing is significant.
    if not count or n_stretches < 2:
        return np.ones(count)
    # The same random signs for all candidates: those that resemble each other stay alike in every draw.
    signs = _draw_signs(n_stretches)
    by_gains, by_scores = _test_gains(gains, signs), _test_scores(scores, signs)
    return np.asarray(np.minimum(1.0, 2.0 * np.minimum(by_gains, by_scores)))


def compute_single_p(gains: FloatArray) -> float:
    """Return how often chance would look as good as the gains (s,) of one candidate, with nothing else tried."""
    return float(_test_gains(gains[None], _draw_signs(len(gains)))[0])


def _draw_signs(n_stretches: int) -> FloatArray:
    """Return random signs (draws, s), of which the first row changes none."""
    # A fixed seed: the same data give the same p-values.
    signs = np.random.default_rng(_SEED).choice([-1.0, 1.0], size=(DRAWS, n_stretches))
    # The observed signs count as one of the draws, so that no p is zero.
    signs[0] = 1.0
    return signs


def _test_gains(gains: FloatArray, signs: FloatArray) -> FloatArray:
    """Return (c,): the share of draws in which any candidate gains as evenly."""
    values = _compute_signed_roots(gains)
    n_stretches = values.shape[1]
    mean = signs @ values.T / n_stretches
    # Signs change the mean of the values and leave their squares: the variance follows without another product.
    variance = np.maximum((values**2).mean(axis=1) - mean**2, np.finfo(float).tiny) * n_stretches / (n_stretches - 1)
    return _compute_share_reached(compute_evenness(gains), (mean / np.sqrt(variance / n_stretches)).max(axis=1))


def _test_scores(scores: Sequence[FloatArray], signs: FloatArray) -> FloatArray:
    """Return (c,): the share of draws in which the scores of any candidate sum up to as much."""
    own, largest = np.full(len(scores), -np.inf), np.full(len(signs), -np.inf)
    # Candidates of equally many parameters are handled together, some at a time.
    for width in {each.shape[1] for each in scores}:
        members = [k for k, each in enumerate(scores) if each.shape[1] == width]
        for first in range(0, len(members), _TOGETHER):
            batch = members[first : first + _TOGETHER]
            values = _standardise_scores(np.array([scores[k] for k in batch]), signs)
            own[batch] = values[0]
            largest = np.maximum(largest, values.max(axis=1))
    return _compute_share_reached(own, largest)


def _compute_share_reached(own: FloatArray, largest: FloatArray) -> FloatArray:
    # The tolerance keeps the observed value, which is among the draws, from missing itself by rounding.
    return np.asarray((len(largest) - np.searchsorted(np.sort(largest), own - 1e-9, side="left")) / len(largest))


def _standardise_scores(scores: FloatArray, signs: FloatArray) -> FloatArray:
    """Return (draws, g): the size of the sums of scores (g, s, k) with random signs, on one scale whatever k.

    Their squares are about those of so many normal variables as agree with their first two moments (Satterthwaite
    1946); the cube root of that is about normal (Wilson and Hilferty 1931).
    """
    spread = scores.transpose(0, 2, 1) @ scores
    mean = np.einsum("gkk->g", spread)
    # Candidates for which only their gains may speak have scores of zero.
    silent = mean <= np.finfo(float).tiny
    mean = np.where(silent, 1.0, mean)
    freedom = np.where(silent, 1.0, mean**2 / np.where(silent, 1.0, (spread**2).sum(axis=(1, 2))))
    g, s, k = scores.shape
    sums = (signs @ scores.transpose(1, 0, 2).reshape(s, g * k)).reshape(-1, g, k)
    root = np.cbrt((sums**2).sum(axis=2) / mean)
    return np.asarray((root - (1.0 - 2.0 / (9.0 * freedom))) / np.sqrt(2.0 / (9.0 * freedom)))


def compute_evenness(gains: FloatArray) -> FloatArray:
    """Return (c,): t of the mean over the blocks of the signed roots of gains (c, s).

    Of the roots, since a gain is a square: else one stretch that shows an effect well hides that the others do, too.
    """
    values = _compute_signed_roots(gains)
    spread = values.std(axis=-1, ddof=1) / np.sqrt(values.shape[-1])
    return np.asarray(np.divide(values.mean(axis=-1), spread, out=np.zeros_like(spread), where=spread > 0))


def _compute_signed_roots(gains: FloatArray) -> FloatArray:
    return np.asarray(np.sign(gains) * np.sqrt(np.abs(gains)))
