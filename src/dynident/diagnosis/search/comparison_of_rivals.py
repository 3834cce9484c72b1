"""Compare a found effect with effects that explain much the same error, each with its shape constants refined.

Holds from how many values of the grid the constants are refined (6).

On the coarse grid a name can win for want of its rival's constants: a spring of a balancer between two angles of the
grid lost to a cable's polynomial. And what is about rows where joints turn or start has more rows to gain on: wide
Stribeck friction won against the quadratic friction that it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from scipy.special import fdtri

from dynident.diagnosis.candidates.candidate_pool import Candidate, build_pool_of_choices
from dynident.diagnosis.candidates.significance import ALPHA, ScoredCandidate, are_indistinguishable
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.search.acceptance_rules import compute_stability
from dynident.diagnosis.search.next_finding import is_seldom_change, select_candidate
from dynident.diagnosis.search.search_state import ProductSource, State, score_all
from dynident.effects import EffectChoice
from dynident.estimation.residual_errors import compute_t
from dynident.identification.shape_search import list_between

# `benchmarks/equal_terms.py` calibrates these; seeds 1 to 3 and 5.


_STARTS = 6
"""Values of a grid from which constants are searched for: their error has several valleys. The best was reached from
these in 177 of 181 cases, from half as many in 161."""

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
    # With those of each kind of rows apart: what is about joints that start has none in common with other friction.
    kinds: dict[tuple[bool, bool], list[Candidate]] = {}
    for candidate in finer.pool.candidates:
        kinds.setdefault(finer.data.find_row_kinds(candidate.columns), []).append(candidate)
    for rivals in kinds.values():
        own = [candidate for candidate in finer.pool.candidates if candidate.effect == choice[0].candidate.effect]
        choice = _compare_on_common_rows(finer, choice, list(dict.fromkeys([*own, *rivals])), parents)
    return choice


def _compare_on_common_rows(
    state: State,
    choice: Choice,
    candidates: Sequence[Candidate],
    parents: Mapping[EffectChoice, ScoredCandidate],
) -> Choice:
    """Return the choice, or another name that explains more of the rows that count for all of these candidates."""
    chosen = choice[0]
    each = [state.data.find_row_kinds(candidate.columns) for candidate in candidates]
    common = all(turns for turns, _ in each), all(starts for _, starts in each)
    rescored = score_all(state, candidates, kinds=common)
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
    told_apart = compute_t(other.gains - slim.gains) >= RULES.apart_t and _exceeds_constant(less, other)
    return (less <= RULES.same_gain * other.total_gain and not told_apart) or are_indistinguishable(other, slim)


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
    """Return the state on a pool of its columns so far and, behind them, other choices as candidates.

    Parameters
    ----------
    rows : ProductSource
        Gives products of further columns.
    state : State
        The model so far and what was found.
    choices : sequence of EffectChoice
        What stands behind these columns.
    """
    base = [state.pool.observation.columns[k] for k in state.base]
    pool = build_pool_of_choices(rows.model, choices, base)
    pool = replace(pool, since=state.pool.since, largest=state.pool.largest)
    return replace(state, data=rows.gather_products(pool), pool=pool, base=tuple(range(pool.n_base)))
