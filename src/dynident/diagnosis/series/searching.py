"""What changed, and from which day on: the decision rule of the diagnosis, asked of every day."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.arrays import FloatArray
from dynident.diagnosis.candidates.gate import JudgedCandidate
from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.search.choosing import choose
from dynident.diagnosis.search.determined import generalises
from dynident.diagnosis.search.pruning import pruned
from dynident.diagnosis.search.state import Finding, State, judge_all, noise_left
from dynident.progress import Progress

_AS_MUCH = 0.9
"""Of what a change explains: what was there all along and says so much of it leaves no change."""

MOST_CHANGES = 12
"""A robot that differs in more is another robot on other days."""


def found_changes(data: PhasedProducts, pool: Pool, floor: FloatArray, progress: Progress) -> tuple[Finding, ...]:
    """Add what gains most from the day on from which it gains most, until nothing does."""
    base = tuple(range(pool.n_base))
    state = State(base, noise_left(data, base), floor, (), pool.since)
    remaining: Sequence[Candidate] = pool.candidates
    firm = generalises(data.of(base), state)
    while remaining and len(state.picks) < MOST_CHANGES:
        progress(len(state.picks) / MOST_CHANGES, f"{len(state.picks)} changes found")
        judged = judge_all(data, pool, state.base, remaining, state.noise)
        own = [item for item in judged if not _is_shadow(item, judged)]
        choice = choose(data, pool, state, [_on_its_side(item, pool, data) for item in own])
        if choice is None:
            break
        chosen, equal = choice
        grown = state.base + chosen.candidate.columns
        state = replace(
            state, base=grown, noise=noise_left(data, grown), picks=(*state.picks, Finding(chosen, equal, chosen.p))
        )
        firm = firm or generalises(data.of(grown), state)
        if not firm:
            return ()
        remaining = [one for one in remaining if not set(one.columns) <= set(grown)]
    return pruned(data, pool, state).picks


def first_day(candidate: Candidate, count: int) -> int:
    """The day of so many, by number, from which on something is there; 0 for all."""
    return count - len(candidate.runs) if candidate.runs else 0


def _is_shadow(item: JudgedCandidate, judged: Sequence[JudgedCandidate]) -> bool:
    """Whether the same on all days says as much, be it even something that nature does not allow."""
    mine = item.candidate
    return bool(mine.runs) and any(
        not other.candidate.runs
        and (other.candidate.effect, other.candidate.joints) == (mine.effect, mine.joints)
        and other.total_gain >= _AS_MUCH * item.total_gain
        for other in judged
    )


def _on_its_side(item: JudgedCandidate, pool: Pool, data: PhasedProducts) -> JudgedCandidate:
    """A change by what it explains before its day or from it on: of ten days, the last is a tenth of all the error."""
    since = first_day(item.candidate, len(pool.since) + 1)
    if not since:
        return item
    later = data.moving.run >= since
    sides = [replace(item, before=item.before[side], after=item.after[side]) for side in (~later, later)]
    best = max(sides, key=_drop)
    return replace(best, drop=max(item.drop, _drop(best)))


def _drop(item: JudgedCandidate) -> float:
    before, after = item.before.sum(axis=0), item.after.sum(axis=0)
    if len(item.candidate.joints) > 1:
        before, after = before.sum(keepdims=True), after.sum(keepdims=True)
    return float(((before - after) / np.maximum(before, np.finfo(float).tiny)).max())
