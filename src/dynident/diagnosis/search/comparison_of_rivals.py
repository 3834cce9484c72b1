"""Compare a found effect with effects that explain much the same error, each with its shape constants refined.

Holds from how many values of the grid the constants are refined (6), and in how many steps (4).

On the coarse grid a name can win for want of its rival's constants: a spring of a balancer between two angles of the
grid lost to a cable's polynomial. And what is about rows where joints turn or start has more rows to gain on: wide
Stribeck friction won against the quadratic friction that it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, build_pool_of_choices
from dynident.diagnosis.candidates.significance import (
    ALPHA,
    ScoredCandidate,
    are_indistinguishable,
    has_larger_gain,
)
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.search.acceptance_rules import compute_stability, find_rejection
from dynident.diagnosis.search.next_finding import check_moving_joints, is_seldom_change, select_candidate
from dynident.diagnosis.search.physical_plausibility import find_impossibility
from dynident.diagnosis.search.search_state import Finding, ProductSource, State, score_all
from dynident.effects import EffectChoice, get_effect
from dynident.estimation.residual_errors import compute_t
from dynident.identification.shape_search import list_between

# `benchmarks/equal_terms.py` calibrates this; seeds 1 to 3 and 5.
_STARTS = 6
"""Values of a grid from which constants are searched for: their error has several valleys. The best was reached from
these in 177 of 181 cases, from half as many in 161."""

_PARTS = 5
"""Parts of a run, of which each is judged with constants chosen in the others."""

WIDTHS = (1.0, 1.0, 0.5, 0.25)
"""How far constants are searched for around the best so far, over half the distance between values of the grid."""


_Known = dict[tuple[bool, bool], dict[Candidate, ScoredCandidate]]
"""Scores beside one model, by the kinds of rows that count."""

Choice = tuple[ScoredCandidate, tuple[ScoredCandidate, ...]]
"""A finding by its name, and its equals."""


def compare_names(rows: ProductSource, state: State, choice: Choice, judged: Sequence[ScoredCandidate]) -> Choice:
    """Return the finding by the name that it has on equal terms, and its equals.

    The name stays as long as another does not say more in nearly every draw of the blocks.

    Parameters
    ----------
    rows : ProductSource
        Gives products of further columns.
    state : State
        The model so far and what was found.
    choice : tuple of ScoredCandidate, tuple of ScoredCandidate
        What was chosen on the grid, and its equals.
    judged : sequence of ScoredCandidate
        All candidates on the grid.

    Returns
    -------
    tuple of ScoredCandidate, tuple of ScoredCandidate
        The finding and its equals.
    """
    contenders = _find_contenders(choice[0], judged)
    if all(scored.candidate.effect == choice[0].candidate.effect for scored in contenders):
        return choice
    parents = {finer: scored for scored in [*contenders, choice[0]] for finer in list_between(scored.candidate.choice)}
    finer = refine_grid(rows, state, list(parents))
    known: _Known = {}
    for rivals in _group_by_rows(finer, finer.pool.candidates):
        own = [candidate for candidate in finer.pool.candidates if candidate.effect == choice[0].candidate.effect]
        choice = _compare_on_common_rows(finer, choice, _score_on_common_rows(finer, [*own, *rivals], known), parents)
    return choice


def _group_by_rows(state: State, candidates: Sequence[Candidate]) -> list[list[Candidate]]:
    """Group candidates by their kind of rows: what is about joints that start has none in common with others."""
    kinds: dict[tuple[bool, bool], list[Candidate]] = {}
    for candidate in candidates:
        kinds.setdefault(state.data.find_row_kinds(candidate.columns), []).append(candidate)
    return list(kinds.values())


def _score_on_common_rows(state: State, candidates: Sequence[Candidate], known: _Known) -> list[ScoredCandidate]:
    """Score candidates, each once, on the rows that count for all of them, less those that are known on these."""
    each = [state.data.find_row_kinds(candidate.columns) for candidate in candidates]
    common = all(turns for turns, _ in each), all(starts for _, starts in each)
    scored = known.setdefault(common, {})
    new = [candidate for candidate in dict.fromkeys(candidates) if candidate not in scored]
    scored.update(zip(new, score_all(state, new, kinds=common), strict=True))
    return [scored[candidate] for candidate in dict.fromkeys(candidates)]


def _compare_on_common_rows(
    state: State,
    choice: Choice,
    rescored: Sequence[ScoredCandidate],
    parents: Mapping[EffectChoice, ScoredCandidate],
) -> Choice:
    """Return the choice, or another name that explains more, of candidates that were scored on the same rows."""
    chosen = choice[0]
    # That something is there is what the test on the grid says; here it is asked what it is called.
    rescored = [replace(scored, p=parents[scored.candidate.choice].p) for scored in rescored]
    selected = select_candidate(state, rescored)
    if selected is None:
        return choice
    # A name with fewer constants that explains as much is preferred, if it passes the same tests.
    slim = select_candidate(state, [scored for scored in rescored if _is_slimmer(state, scored, selected[0])])
    selected = slim or selected
    # The finer constants decide the name only; the finding itself stays one of the grid, which is refined later.
    winner = parents.get(selected[0].candidate.choice)
    if winner is None:
        return choice
    if winner.candidate.effect == chosen.candidate.effect:
        return replace(winner, p=chosen.p), choice[1]
    own = [scored for scored in rescored if scored.candidate.effect == chosen.candidate.effect]
    before = max(own, key=lambda scored: scored.total_gain)
    if slim is None and compute_stability([selected[0]], [before], state.data.moving.run) < state.rules.found_again:
        return choice
    equal = {scored.candidate.effect: parents.get(scored.candidate.choice) for scored in selected[1]}
    others = [scored for effect, scored in equal.items() if scored is not None and effect != winner.candidate.effect]
    return replace(winner, p=chosen.p), tuple(others)


def _is_slimmer(state: State, slim: ScoredCandidate, other: ScoredCandidate) -> bool:
    """Return whether a name with fewer constants explains as much; what seldom changes from day to day is no better."""
    return slim.freedom < other.freedom and explains_as_much(slim, other) and not is_seldom_change(state, slim)


def explains_as_much(slim: ScoredCandidate, other: ScoredCandidate) -> bool:
    """Return whether a candidate gains as much as one with more constants, each of which is the best of many.

    Parameters
    ----------
    slim, other : ScoredCandidate
        The candidate with fewer constants, and the one with more, scored on the same rows.
    """
    less = other.total_gain - slim.total_gain
    is_close = less <= RULES.same_gain * other.total_gain and not _are_told_apart(slim, other)
    return is_close or are_indistinguishable(other, slim)


def _are_told_apart(less: ScoredCandidate, more: ScoredCandidate) -> bool:
    """Return whether one of two candidates gains more than another evenly, and more than a constant would by chance."""
    difference = more.gains - less.gains
    return compute_t(difference) >= RULES.clear_t and _exceeds_constant(float(difference.sum()), more)


def _exceeds_constant(more: float, other: ScoredCandidate) -> bool:
    """Return whether a name gains more than a constant that is fitted to what it leaves would by chance.

    A block counts as one sample. That constants are the best of many is why t alone says too much.
    """
    blocks = len(other.gains)
    return more * (blocks - 1) >= float(fdtri(1, blocks - 1, 1.0 - ALPHA)) * float(other.after_weighted.sum())


def _find_contenders(chosen: ScoredCandidate, judged: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
    """Find the best candidates of every effect that gains nearly as much on joints of the chosen one."""
    mine = chosen.candidate
    near = [
        scored
        for scored in sorted(judged, key=lambda scored: -scored.total_gain)
        if scored.candidate.runs == mine.runs
        and not set(scored.joints).isdisjoint(chosen.joints)
        and scored.total_gain >= RULES.contends * chosen.total_gain
    ]
    contenders: list[ScoredCandidate] = []
    for effect in dict.fromkeys(scored.candidate.effect for scored in near):
        own = [scored for scored in near if scored.candidate.effect == effect]
        same = [scored for scored in own if scored.candidate.joints == mine.joints]
        # One set of joints for each effect: that of the chosen name if there is one, else the best.
        joints = (same or own)[0].candidate.joints
        contenders += [scored for scored in own if scored.candidate.joints == joints][:_STARTS]
    return contenders


Scores = Mapping[str, Sequence[ScoredCandidate]]
"""By effect, what is compared on the same rows."""

Starts = dict[EffectChoice, ScoredCandidate]
"""What a finding may be called, and what each is on the grid."""


def name_findings(rows: ProductSource, state: State) -> State:
    """Give findings the names that they have beside all others, with constants between those of the grid.

    The search named each beside what it knew by then, with constants of the grid. A name stays unless another says more
    in nearly every draw; what explains alike within chance is its equal.
    """
    starts = [_list_names(state, finding) for finding in state.findings]
    if not any(starts):
        return state
    # Constants are searched for around those of the grid, and then around the best of these.
    *wide, last = WIDTHS
    for width in wide:
        names = _gather_names(rows, state, [list_finer(own, width) for own in starts])
        starts = [
            _select_best(_score_names(names, state.findings, number), own) for number, own in enumerate(names.known)
        ]
    names = _gather_names(rows, state, [list_finer(own, last) for own in starts])
    findings = list(state.findings)
    # One after another, each beside the names that the earlier ones have got: two may not get the same.
    for number, finding in enumerate(state.findings):
        if names.known[number]:
            groups = _score_names(names, findings, number)
            findings[number], names.present[number] = _name_finding(names, number, finding, groups)
    rest = state.drop_columns({k for finding in state.findings for k in finding.columns})
    base = (*rest.base, *(k for finding in findings for k in finding.columns))
    return replace(state, base=base, findings=tuple(findings))


def list_finer(starts: Starts, width: float) -> Starts:
    """List names with constants around those of others, each with what it is on the grid; the first ones count."""
    return {other: starts[choice] for choice in reversed(starts) for other in list_between(choice, width)}


def _list_names(state: State, finding: Finding) -> Starts:
    """List what a finding may be called beside all others, on the grid, its own name first; none without a rival."""
    mine, without_it = finding.judged.candidate, state.drop_findings([finding])
    if finding.is_transient:
        return {}
    candidates = [mine, *_list_rivals(state, finding, without_it)]
    # That something is there was tested among all that could be.
    own, *others = [replace(scored, p=finding.p) for scored in score_all(without_it, candidates)]
    near = [own, *_find_contenders(own, others)]
    has_rival = any(scored.candidate.effect != mine.effect for scored in near)
    return {scored.candidate.choice: scored for scored in near} if has_rival else {}


@dataclass(frozen=True, eq=False)
class _Names:
    """What findings may be called, with the products of all these names.

    Parameters
    ----------
    finer : State
        The model without the findings, on a pool of the names.
    known : sequence of Starts
        What each finding may be called.
    present : list of Candidate or None
        What each finding is called by now; None where the model has its columns already.
    """

    finer: State
    known: Sequence[Starts]
    present: list[Candidate | None]

    def get_state_beside(self, number: int) -> State:
        """Return the model with all findings but one."""
        others = [other for k, other in enumerate(self.present) if k != number and other is not None]
        return replace(self.finer, base=(*self.finer.base, *(k for other in others for k in other.columns)))


def _gather_names(rows: ProductSource, state: State, known: Sequence[Starts]) -> _Names:
    """Gather the products of all names in one pass over the recordings."""
    mine = [finding.judged.candidate.choice for finding in state.findings]
    rest = state.drop_columns({k for finding in state.findings for k in finding.columns})
    # Two names of the same columns are one: that of the finding.
    finer = refine_grid(rows, rest, list(dict.fromkeys([*mine, *(choice for own in known for choice in own)])))
    return _Names(finer, known, [finer.pool.find_candidate(choice) for choice in mine])


def _score_names(names: _Names, findings: Sequence[Finding], number: int) -> list[Scores]:
    """Score the names of a finding beside all other findings, those that are about the same rows together."""
    finding, others = findings[number], [*findings[:number], *findings[number + 1 :]]
    candidates = [
        candidate
        for candidate in names.finer.pool.candidates
        if candidate.choice in names.known[number]
        and (candidate.effect == finding.judged.candidate.effect or _is_admissible(candidate, others))
    ]
    return _score_by_rows(names.get_state_beside(number), finding, candidates)


def _score_by_rows(state: State, finding: Finding, candidates: Sequence[Candidate]) -> list[Scores]:
    """Score candidates with the finding's own on the rows that count for all, one kind of rows after another."""
    name = finding.judged.candidate.effect
    own = [candidate for candidate in candidates if candidate.effect == name]
    groups: list[Scores] = []
    known: _Known = {}
    for members in _group_by_rows(state, candidates):
        scores: dict[str, list[ScoredCandidate]] = {}
        for scored in _score_on_common_rows(state, [*own, *members], known):
            if scored.candidate.effect == name or _is_acceptable(state, replace(scored, p=finding.p)):
                scores.setdefault(scored.candidate.effect, []).append(replace(scored, p=finding.p))
        groups.append(scores)
    return groups


def _select_best(groups: Sequence[Scores], known: Starts) -> Starts:
    """Return the best constants of every name."""
    best = [_find_best(each).candidate.choice for scores in groups for each in scores.values()]
    return {choice: known[choice] for choice in best}


def _find_best(scores: Sequence[ScoredCandidate]) -> ScoredCandidate:
    return max(scores, key=lambda scored: scored.total_gain)


def _name_finding(
    names: _Names, number: int, finding: Finding, groups: Sequence[Scores]
) -> tuple[Finding, Candidate | None]:
    """Return a finding by the name that it has beside all others, with its equals, and that name's finer constants."""
    beside, known = names.get_state_beside(number), names.known[number]
    before = name = finding.judged.candidate.effect
    groups = [_drop_names_at_reversals(beside, scores, before) for scores in groups]
    for scores in groups:
        name = _choose_name(beside, scores, name) if name in scores else name
    here = [scores for scores in groups if name in scores]
    best = {effect: _find_best(each) for scores in here for effect, each in scores.items()}
    alike = {effect for scores in here for effect in scores if _are_alike(beside, scores, name, effect)}
    ranked = sorted((best[effect] for effect in alike), key=lambda scored: -scored.total_gain)
    # Names on other joints or in other runs were not compared here.
    place = finding.judged.candidate.joints, finding.judged.candidate.runs
    elsewhere = [scored for scored in finding.equal if (scored.candidate.joints, scored.candidate.runs) != place]
    equal = (*(known[scored.candidate.choice] for scored in ranked), *elsewhere)
    if name == before:
        return replace(finding, equal=equal), names.present[number]
    former = (replace(finding.judged, p=finding.p), *finding.former)
    new = best[name].candidate
    return Finding(known[new.choice], equal, finding.p, former=former), new


def _drop_names_at_reversals(state: State, scores: Scores, name: str) -> Scores:
    """Drop other names than the finding's own that say nothing where joints move on."""
    return {
        effect: each
        for effect, each in scores.items()
        if effect == name or check_moving_joints(state, _find_best(each)) is None
    }


def _choose_name(state: State, scores: Scores, name: str) -> str:
    """Return the effect that explains more in nearly every draw, or as much as that with fewer constants.

    With more constants than the name so far it has to explain clearly more.
    """
    best = {effect: _find_best(each) for effect, each in scores.items()}
    own, run = best[name], state.data.moving.run
    ahead = [
        scored
        for scored in best.values()
        if scored.total_gain > own.total_gain
        and (scored.freedom <= own.freedom or has_larger_gain(scored, own))
        and not is_seldom_change(state, scored)
        and compute_stability([scored], [own], run) >= state.rules.found_again
    ]
    if not ahead:
        return name
    winner = _find_best(ahead)
    slim = [scored for scored in best.values() if _is_slimmer(state, scored, winner)]
    return max(slim, key=lambda scored: scored.total_gain, default=winner).candidate.effect


def _are_alike(state: State, scores: Scores, name: str, other: str) -> bool:
    """Return whether another name explains as much within chance, each with constants chosen on other blocks."""
    # What is so general that it includes the effect says nothing else.
    if other == name or name in get_effect(other).covers:
        return False
    mine, theirs = (
        replace(_find_best(scores[effect]), gains=_nest_gains(scores[effect], state.data.moving.run))
        for effect in (name, other)
    )
    # Nor does what needs more constants to explain no more.
    if theirs.freedom > mine.freedom and theirs.total_gain <= mine.total_gain:
        return False
    # What explains more, but not surely enough to be the name, is one that data leave open.
    return not _are_told_apart(theirs, mine)


def _is_acceptable(state: State, scored: ScoredCandidate) -> bool:
    return find_rejection(state, scored) is None and find_impossibility(state, scored) is None


def _nest_gains(scores: Sequence[ScoredCandidate], run: IndexArray) -> FloatArray:
    """Return the gains (s,) of an effect, in every part of the data with the constants that gain most in the others.

    Parts are runs, or fifths of each run where the effect acts in one run only. Only the choice of the constants is
    made without the part: what they gain in the others comes from fits that may contain it.
    """
    gains = np.array([scored.gains for scored in scores])
    parts = run.copy()
    if len(np.unique(run)) == 1 or len(scores[0].candidate.runs) == 1:
        for number in np.unique(run):
            blocks = np.flatnonzero(run == number)
            parts[blocks] = np.arange(len(blocks)) * _PARTS // len(blocks)
    nested = np.zeros(gains.shape[1])
    for part in np.unique(parts):
        here = parts == part
        nested[here] = gains[gains[:, ~here].sum(axis=1).argmax(), here]
    return nested


def _list_rivals(state: State, finding: Finding, without_it: State) -> list[Candidate]:
    """List other candidates on the joints of a finding, in the same runs: only its name is in question."""
    mine = finding.judged.candidate
    # What a function of the position leaves is one, too: no other name for something else on its joint.
    shadowed = not get_effect(mine.effect).of_position and any(
        get_effect(other.judged.candidate.effect).of_position and set(other.judged.candidate.joints) & set(mine.joints)
        for other in without_it.findings
    )
    return [
        candidate
        for candidate in state.pool.candidates
        if (candidate.joints, candidate.runs) == (mine.joints, mine.runs)
        and _is_admissible(candidate, without_it.findings)
        and not (shadowed and get_effect(candidate.effect).of_position)
        and candidate != mine
        and not set(candidate.columns) & set(without_it.base)
    ]


def list_other_names(best: ScoredCandidate, as_good: Sequence[ScoredCandidate]) -> tuple[ScoredCandidate, ...]:
    """List the best candidate of every other effect among those that explain as much."""
    names: dict[str, ScoredCandidate] = {}
    for scored in sorted(as_good, key=lambda scored: -scored.total_gain):
        if scored.candidate.effect != best.candidate.effect:
            names.setdefault(scored.candidate.effect, scored)
    return tuple(names.values())


def _is_admissible(candidate: Candidate, others: Sequence[Finding]) -> bool:
    """Return whether a candidate is none of the other findings, nor contained in one."""
    return not any(
        other.judged.candidate.effect == candidate.effect
        or candidate.effect in get_effect(other.judged.candidate.effect).covers
        for other in others
        if set(other.judged.candidate.joints) & set(candidate.joints)
    )


def list_starts(judged: Sequence[ScoredCandidate]) -> list[ScoredCandidate]:
    """List the best few candidates of every effect, from which constants between those of the grid are searched for."""
    best = sorted(judged, key=lambda scored: -scored.total_gain)
    effects = dict.fromkeys(scored.candidate.effect for scored in best)
    return [
        scored
        for name in effects
        for scored in [scored for scored in best if scored.candidate.effect == name][:_STARTS]
    ]


def refine_grid(rows: ProductSource, state: State, choices: Sequence[EffectChoice]) -> State:
    """Return the state on a pool of its columns so far and, behind them, other choices as candidates."""
    base = [state.pool.observation.columns[k] for k in state.base]
    pool = build_pool_of_choices(rows.model, choices, base)
    pool = replace(pool, since=state.pool.since, largest=state.pool.largest)
    return replace(state, data=rows.gather_products(pool), pool=pool, base=tuple(range(pool.n_base)))
