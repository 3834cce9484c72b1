"""Search for changes and the days from which they hold, by the decision rules of the diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.diagnosis.candidates.gate import ScoredCandidate
from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.search.choosing import select_candidate
from dynident.diagnosis.search.determined import is_determined
from dynident.diagnosis.search.pruning import prune_findings
from dynident.diagnosis.search.state import Finding, State, estimate_residual_noise, score_all
from dynident.progress import Progress

_AS_MUCH = 0.9
"""Of what a change explains: what was there all along and says so much of it leaves no change."""

MOST_CHANGES = 12
"""A robot that differs in more is another robot on other days."""


def find_changes(data: PhasedProducts, pool: Pool, floor: FloatArray, progress: Progress) -> tuple[Finding, ...]:
    """Add the change that gains most, from the day from which it gains most, until none passes.

    Parameters
    ----------
    data : PhasedProducts
        Of the days' columns, `stepped_products`.
    pool : Pool
    floor : (n,)
        Noise of the sensors.
    progress : Progress

    Returns
    -------
    tuple of Finding
    """
    base = tuple(range(pool.n_base))
    state = State(base, estimate_residual_noise(data, base), floor, (), pool.since)
    remaining: Sequence[Candidate] = pool.candidates
    firm = is_determined(data.select_for_model(base), state)
    while remaining and len(state.picks) < MOST_CHANGES:
        progress(len(state.picks) / MOST_CHANGES, f"{len(state.picks)} changes found")
        judged = score_all(data, pool, state.base, remaining, state.noise)
        unshadowed = [scored for scored in judged if not _is_shadow(scored, judged)]
        choice = select_candidate(data, pool, state, [_judge_by_side(scored, pool, data) for scored in unshadowed])
        if choice is None:
            break
        chosen, equal = choice
        grown = state.base + chosen.candidate.columns
        state = replace(
            state,
            base=grown,
            noise=estimate_residual_noise(data, grown),
            picks=(*state.picks, Finding(chosen, equal, chosen.p)),
        )
        # Where the motion does not determine the model, a gain may only be a better conditioned model. Then nothing is
        # named.
        firm = firm or is_determined(data.select_for_model(grown), state)
        if not firm:
            return ()
        remaining = [candidate for candidate in remaining if not set(candidate.columns) <= set(grown)]
    return prune_findings(data, pool, state).picks


def get_first_day(candidate: Candidate, count: int) -> int:
    """Return the number of the day, of `count`, from which on a candidate is there; 0 for all days."""
    return count - len(candidate.runs) if candidate.runs else 0


def _is_shadow(scored: ScoredCandidate, judged: Sequence[ScoredCandidate]) -> bool:
    """Return whether the same effect on all days explains as much, even if nature does not allow it."""
    mine = scored.candidate
    return bool(mine.runs) and any(
        not other.candidate.runs
        and (other.candidate.effect, other.candidate.joints) == (mine.effect, mine.joints)
        and other.total_gain >= _AS_MUCH * scored.total_gain
        for other in judged
    )


def _judge_by_side(scored: ScoredCandidate, pool: Pool, data: PhasedProducts) -> ScoredCandidate:
    """Return a change judged by the better of two sides: the days before it, or the days from it on."""
    since = get_first_day(scored.candidate, len(pool.since) + 1)
    if not since:
        return scored
    later = data.moving.run >= since
    # Of ten days, the last has a tenth of all the error: over all days even a complete change would explain little.
    sides = [replace(scored, before=scored.before[side], after=scored.after[side]) for side in (~later, later)]
    best = max(sides, key=_compute_drop)
    return replace(best, drop=max(scored.drop, _compute_drop(best)))


def _compute_drop(scored: ScoredCandidate) -> float:
    before, after = scored.before.sum(axis=0), scored.after.sum(axis=0)
    if len(scored.candidate.joints) > 1:
        before, after = before.sum(keepdims=True), after.sum(keepdims=True)
    return float(((before - after) / np.maximum(before, np.finfo(float).tiny)).max())
