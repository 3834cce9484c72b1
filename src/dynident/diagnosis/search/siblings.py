"""Friction that was found on one joint, asked about on the others: drives of one arm are much alike.

Among all that could be missing anywhere the best of hundreds reaches a large t by chance. Where an effect has been
found, its other joints are a small family of their own, which is tested at the same level by itself (hierarchical
tests: Meinshausen 2008; of selected families: Benjamini and Bogomolov 2014).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.search.choosing import choose
from dynident.diagnosis.search.state import Finding, State, judge_all, noise_left
from dynident.effects import effect_by_id


def with_siblings(data: PhasedProducts, pool: Pool, state: State, most: int) -> State:
    """The search with the friction that it found, on further joints that have it.

    There it is named only if among all that could be missing on the joint no other name says more.
    """
    for effect in dict.fromkeys(_spreading(state.picks)):
        while len(state.picks) < most:
            found = _sibling(data, pool, state, effect)
            if found is None:
                break
            base = state.base + found.columns
            state = replace(state, base=base, noise=noise_left(data, base), picks=(*state.picks, found))
    return state


def _spreading(picks: Sequence[Finding]) -> list[str]:
    """Effects among the findings that any joint may have for the same reason."""
    mine = [finding.judged.candidate for finding in picks]
    return [one.effect for one in mine if one.joints and not one.runs and effect_by_id(one.effect).is_friction]


def _sibling(data: PhasedProducts, pool: Pool, state: State, effect: str) -> Finding | None:
    free = [one for one in pool.candidates if _is_free(one, state)]
    own = [one for one in free if one.effect == effect]
    passing = [item for item in judge_all(data, pool, state.base, own, state.noise) if item.passes]
    best = max(passing, key=lambda item: item.total_gain, default=None)
    if best is None:
        return None
    here = [one for one in free if one.joints == best.candidate.joints]
    # That something is there the test among siblings says; here it is asked what it is called.
    judged = [replace(item, p=best.p) for item in judge_all(data, pool, state.base, here, state.noise)]
    choice = choose(data, pool, state, judged)
    if choice is None or choice[0].candidate.effect != effect:
        return None
    return Finding(choice[0], choice[1], best.p)


def _is_free(candidate: Candidate, state: State) -> bool:
    """Whether it is about one joint, at all times, and no finding there says the same."""
    if len(candidate.joints) != 1 or candidate.runs or set(candidate.columns) & set(state.base):
        return False
    here = [pick.judged.candidate for pick in state.picks if candidate.joints[0] in pick.judged.candidate.joints]
    return not any(
        candidate.effect == one.effect or candidate.effect in effect_by_id(one.effect).covers for one in here
    )
