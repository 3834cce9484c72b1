"""Revisit findings beside later ones: give waves another name, and merge two findings that one effect explains."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from dynident.diagnosis.candidates.accumulate import PhasedProducts
from dynident.diagnosis.candidates.physical_constraints import is_physically_possible
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.search.model_comparison import build_finer_pool, compare_names, explains_as_much, list_starts
from dynident.diagnosis.search.selection import select_candidate
from dynident.diagnosis.search.state import Finding, State, score_all
from dynident.effects import get_effect
from dynident.identification.shapes.shape_search import list_between
from dynident.regressors.model import Model


def merge_findings(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State) -> State:
    """Merge several findings on a joint into one, where that one explains as much.

    Parameters
    ----------
    rows : ProductSource
        Gives products of further columns.
    data : PhasedProducts
        Products of all columns.
    pool : Pool
        Model and candidates.
    state : State
        The model so far and what was found.
    """
    for several in _group_by_joint(state.picks):
        state = _merge_group(rows, data, pool, state, several)
    return state


def _group_by_joint(picks: Sequence[Finding]) -> list[list[Finding]]:
    """Group findings that are functions of the position of the same joint, in the same runs."""
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
    # One effect is the better explanation only if it has no more parameters and constants than all of them together.
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
    # The findings as one candidate, so that it can be compared with each single effect.
    both, *each = score_all(fine, finer, here, [together, *singles], state.noise)
    as_good = [
        option
        for option in each
        if explains_as_much(option, both) and is_physically_possible(fine, finer, here, state.noise, option)
    ]
    best = max(as_good, key=lambda scored: scored.total_gain, default=None)
    if best is None:
        return state
    # That something is there was tested for each of them; the new name takes over the surest test.
    p = min(finding.p for finding in several)
    new = Finding(replace(parents[best.candidate.choice], p=p), (), p)
    picks = [new if pick is several[0] else pick for pick in state.picks]
    remaining = tuple(pick for pick in picks if pick is new or pick not in several)
    return replace(state, base=without_them.base + new.columns, picks=remaining)


def _list_single_curves(pool: Pool, beside: State, several: Sequence[Finding]) -> list[Candidate]:
    """List curves over the position of that joint; none so general that it explains whatever was found."""
    mine = several[0].judged.candidate
    names = {finding.judged.candidate.effect for finding in several}
    candidates = []
    for candidate in pool.candidates:
        effect = get_effect(candidate.effect)
        alike = candidate.joints == mine.joints and candidate.runs == mine.runs and effect.of_position
        if alike and not names & set(effect.covers) and not set(candidate.columns) & set(beside.base):
            candidates.append(candidate)
    return candidates


class ProductSource(Protocol):
    """Source of the products of any columns."""

    @property
    def model(self) -> Model:
        """The model in which something is missing."""

    def gather_products(self, pool: Pool) -> PhasedProducts:
        """Return inner products of all columns of a pool and of the torque."""

    def add_findings(self, findings: Sequence[Finding]) -> ProductSource:
        """Return the same with the torque predicted by the model with these findings in it."""


def revisit_findings(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State) -> State:
    """Give functions of a joint's position the names that they have beside all that was found on that joint.

    Parameters
    ----------
    rows : ProductSource
        Gives products of further columns.
    data : PhasedProducts
        Products of all columns.
    pool : Pool
        Model and candidates.
    state : State
        The model so far and what was found.
    """
    for number, finding in enumerate(state.picks):
        later = state.picks[number + 1 :]
        # Another function of the position says what its constants are off by, until they are refined.
        others = [other for other in later if not is_of_position(other)]
        if _may_be_a_wave(finding) and any(_share_a_joint(finding, other) for other in others):
            state = _rename_finding(rows, data, pool, state, number)
    return state


def _rename_finding(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State, number: int) -> State:
    finding = state.picks[number]
    mine = finding.judged.candidate
    others = (*state.picks[:number], *state.picks[number + 1 :])
    without_it = replace(state, base=tuple(k for k in state.base if k not in finding.columns), picks=others)
    # The same joint in the same runs: only the name is in question.
    free = [
        candidate for candidate in pool.candidates if candidate.joints == mine.joints and candidate.runs == mine.runs
    ]
    free = [
        candidate
        for candidate in free
        if _is_admissible(candidate, others) and not set(candidate.columns) & set(without_it.base)
    ]
    judged = score_all(data, pool, without_it.base, free, state.noise)
    # That something is there was tested among all that could be.
    judged = [replace(scored, p=finding.p) for scored in judged]
    choice = select_candidate(data, pool, without_it, judged)
    if choice is None:
        return state
    chosen, equal = compare_names(rows.model, pool, without_it, choice, judged, rows.gather_products)
    new = Finding(chosen, equal, finding.p)
    picks = (*state.picks[:number], new, *state.picks[number + 1 :])
    return replace(state, base=without_it.base + new.columns, picks=picks)


def is_of_position(finding: Finding) -> bool:
    """Return whether a finding is a function of the positions and the direction alone."""
    return get_effect(finding.judged.candidate.effect).of_position


def _may_be_a_wave(finding: Finding) -> bool:
    """Return whether a finding is, or might be called, a wave over the joint's angle."""
    names = {finding.judged.candidate.effect, *(scored.candidate.effect for scored in finding.equal)}
    known = {other for name in names for other in (name, *get_effect(name).confused_with, *get_effect(name).covers)}
    return any(get_effect(name).proposal == "angle_spectrum" for name in known)


def _is_admissible(candidate: Candidate, others: Sequence[Finding]) -> bool:
    """Return whether a candidate is none of the other findings, nor contained in one."""
    return not any(
        other.judged.candidate.effect == candidate.effect
        or candidate.effect in get_effect(other.judged.candidate.effect).covers
        for other in others
        if set(other.judged.candidate.joints) & set(candidate.joints)
    )


def _share_a_joint(first: Finding, second: Finding) -> bool:
    return bool(set(first.judged.candidate.joints) & set(second.judged.candidate.joints))
