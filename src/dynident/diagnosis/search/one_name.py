"""One name for what two findings say together: curves over the position of one joint that a single curve says as well.

The simplest name comes first, and what it leaves gets a name of its own: of a balancer's spring, over the range that a
joint happened to move in, an offset was found and then a ripple.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.plausible import is_physically_possible
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.search.contest import build_finer_pool, explains_as_much, list_starts
from dynident.diagnosis.search.reconsidering import ProductSource, is_of_position
from dynident.diagnosis.search.state import Finding, State, score_all
from dynident.effects import get_effect
from dynident.identification.shapes.shapes import list_between


def merge_findings(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State) -> State:
    """The search with one finding instead of several on a joint, where that one explains as much."""
    for several in _group_by_joint(state.picks):
        state = _merge_group(rows, data, pool, state, several)
    return state


def _group_by_joint(picks: Sequence[Finding]) -> list[list[Finding]]:
    """Findings that are functions of the position of the same joint, in the same runs."""
    places: dict[object, list[Finding]] = {}
    for pick in picks:
        mine = pick.judged.candidate
        if is_of_position(pick) and len(mine.joints) == 1:
            places.setdefault((mine.joints, mine.runs), []).append(pick)
    return [findings for findings in places.values() if len(findings) > 1]


def _merge_group(
    rows: ProductSource, data: PhasedProducts, pool: Pool, state: State, several: Sequence[Finding]
) -> State:
    removed = {column for finding in several for column in finding.columns}
    others = tuple(pick for pick in state.picks if pick not in several)
    without_them = replace(state, base=tuple(k for k in state.base if k not in removed), picks=others)
    most = sum(finding.judged.freedom for finding in several)
    judged = score_all(data, pool, without_them.base, _list_single_curves(pool, without_them, several), state.noise)
    judged = [scored for scored in judged if scored.freedom <= most]
    parents = {finer: scored for scored in list_starts(judged) for finer in list_between(scored.candidate.choice)}
    theirs = [finding.judged.candidate.choice for finding in several]
    finer = build_finer_pool(rows.model, pool, without_them, [*theirs, *parents])
    columns = tuple(
        k
        for column_candidate in finer.candidates
        if column_candidate.choice in theirs
        for k in column_candidate.columns
    )
    first = several[0].judged.candidate
    together = Candidate(first.effect, first.joints, (), columns, first.runs)
    singles = [candidate for candidate in finer.candidates if candidate.choice in parents]
    # The columns of the search without them are the finer pool's first.
    here = tuple(range(finer.n_base))
    fine = rows.gather_products(finer)
    both, *each = score_all(fine, finer, here, [together, *singles], state.noise)
    as_good = [
        option
        for option in each
        if explains_as_much(option, both) and is_physically_possible(fine, finer, here, state.noise, option)
    ]
    best = max(as_good, key=lambda scored: scored.total_gain, default=None)
    if best is None:
        return state
    p = min(finding.p for finding in several)
    new = Finding(replace(parents[best.candidate.choice], p=p), (), p)
    picks = [new if pick is several[0] else pick for pick in state.picks]
    remaining = tuple(pick for pick in picks if pick is new or pick not in several)
    return replace(state, base=without_them.base + new.columns, picks=remaining)


def _list_single_curves(pool: Pool, beside: State, several: Sequence[Finding]) -> list[Candidate]:
    """Curves over the position of that joint; none so general that it explains whatever was found."""
    mine = several[0].judged.candidate
    names = {finding.judged.candidate.effect for finding in several}
    candidates = []
    for candidate in pool.candidates:
        effect = get_effect(candidate.effect)
        alike = candidate.joints == mine.joints and candidate.runs == mine.runs and effect.of_position
        if alike and not names & set(effect.covers) and not set(candidate.columns) & set(beside.base):
            candidates.append(candidate)
    return candidates
