"""Check whether the same name would be found in other data of the same kind, by resampling blocks of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.effects import get_effect

FOUND_AGAIN = 0.9
"""In so many of the resamplings a name has to come first again."""

# Resamplings: a share of 0.9 is then known to within 0.02.
_DRAWS = 200
_SEED = 21

_MORE = 0.2
"""A candidate with more parameters takes the place of a simpler one if it gains so much more."""


def compute_stability(names: Sequence[ScoredCandidate], rivals: Sequence[ScoredCandidate], run: IndexArray) -> float:
    """Return the share of resamplings in which one of these names for a finding is not overtaken by another.

    Parameters
    ----------
    names : sequence of ScoredCandidate
        The names that the data do not tell apart, the chosen one first.
    rivals : sequence of ScoredCandidate
        Candidates that would take its place, beside which nothing of it is left.
    run : (s,)
        Number of the run of each block: without any one of several runs, the name has to stand as well.

    Returns
    -------
    float
        Share from 0 to 1.
    """
    if not rivals:
        return 1.0
    # Gains are sums over blocks, so that the margin of a resample is a weighted sum of these.
    margins = np.array([[_compute_margin(name, rival) for rival in rivals] for name in names])
    s = len(names[0].gains)
    # Bootstrap: how often each block is drawn stands for the block itself, since gains are sums over blocks.
    drawn = np.random.default_rng(_SEED).multinomial(s, np.full(s, 1.0 / s), size=_DRAWS).astype(np.float64)
    share = _compute_share_ahead(margins, drawn)
    runs = np.unique(run)
    if len(runs) < 2:
        return share
    without = np.array([run != left_out_run for left_out_run in runs], dtype=np.float64)
    # Leaving out a run is the harder test: blocks of one run resemble each other.
    return min(share, _compute_share_ahead(margins, without))


def _compute_share_ahead(margins: FloatArray, counts: FloatArray) -> float:
    """Return the share of draws (d, s) in which any name is ahead of all rivals, from margins (f, r, s)."""
    return float((margins @ counts.T >= 0.0).all(axis=1).any(axis=0).mean())


def is_other_name(chosen: ScoredCandidate, rival: ScoredCandidate) -> bool:
    """Return whether a candidate would be another name: another effect that is not known to be the same function.

    Parameters
    ----------
    chosen, rival : ScoredCandidate
        The candidates to compare.
    """
    mine, theirs = get_effect(chosen.candidate.effect), get_effect(rival.candidate.effect)
    if theirs.id == mine.id:
        return False
    return theirs.id not in mine.same_function and mine.id not in theirs.covers and theirs.id not in mine.covers


def _compute_margin(chosen: ScoredCandidate, rival: ScoredCandidate) -> FloatArray:
    """Return (s,): how much each block speaks for the chosen candidate; below zero in sum it would not be chosen."""
    if rival.complexity > chosen.complexity:
        return np.asarray(chosen.gains - (1.0 - _MORE) * rival.gains)
    return np.asarray(chosen.gains - rival.gains)
