"""What was found first on a joint, asked about once more beside what was found on it later.

A wave over the angle is looked for in what the model leaves, and whatever else is missing on its joint moves it: a
ripple of two waves beside friction that grows with the load was taken for a balancer's spring.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool
from dynident.diagnosis.search.choosing import select_candidate
from dynident.diagnosis.search.contest import compare_names
from dynident.diagnosis.search.state import Finding, State, score_all
from dynident.effects import get_effect
from dynident.regressors.model import Model


class ProductSource(Protocol):
    """Where the products of any columns come from."""

    @property
    def model(self) -> Model:
        """The model in which something is missing."""

    def gather_products(self, pool: Pool) -> PhasedProducts:
        """Inner products of all columns of a pool and of the torque."""

    def add_findings(self, findings: Sequence[Finding]) -> ProductSource:
        """The same, with the torque predicted by the model with these findings in it."""


def revisit_findings(rows: ProductSource, data: PhasedProducts, pool: Pool, state: State) -> State:
    """The search with the names that functions of a joint's position have beside all that was found on that joint."""
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
    """Whether it is a function of the positions and the direction alone."""
    return get_effect(finding.judged.candidate.effect).of_position


def _may_be_a_wave(finding: Finding) -> bool:
    """Whether it is, or might be called, a wave over the joint's angle."""
    names = {finding.judged.candidate.effect, *(scored.candidate.effect for scored in finding.equal)}
    known = {other for name in names for other in (name, *get_effect(name).confused_with, *get_effect(name).covers)}
    return any(get_effect(name).proposal == "angle_spectrum" for name in known)


def _is_admissible(candidate: Candidate, others: Sequence[Finding]) -> bool:
    """Whether it is none of the other findings, nor contained in one."""
    return not any(
        other.judged.candidate.effect == candidate.effect
        or candidate.effect in get_effect(other.judged.candidate.effect).covers
        for other in others
        if set(other.judged.candidate.joints) & set(candidate.joints)
    )


def _share_a_joint(first: Finding, second: Finding) -> bool:
    return bool(set(first.judged.candidate.joints) & set(second.judged.candidate.joints))
