"""Names that take much of the same error, weighed once more on equal terms.

On the coarse grid a name can win for want of its rival's constants: a spring of a balancer between two angles of the
grid lost to a cable's polynomial. And what is about rows where joints turn or start has more rows to gain on: wide
Stribeck friction won against the quadratic friction that it was.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from scipy.special import fdtri

from dynident.diagnosis.candidates.gate import ALPHA, JudgedCandidate, indistinguishable
from dynident.diagnosis.candidates.gathering import PhasedProducts
from dynident.diagnosis.candidates.pool import Candidate, Pool, pool_of
from dynident.diagnosis.candidates.resampling import FOUND_AGAIN, share_found_again
from dynident.diagnosis.residuals.stretches import t_of
from dynident.diagnosis.search.choosing import choose, is_seldom_change
from dynident.diagnosis.search.state import State, judge_all
from dynident.effects import EffectChoice
from dynident.identification.shapes.shapes import between
from dynident.regressors.model import Model

# `benchmarks/equal_terms.py` calibrates these; seeds 1 to 3 and 5.

_CONTENDS = 0.7
"""Of what the chosen name gains: a coarse constant costs up to a quarter of a gain, so that less overtakes no more. Of
seven right names that lagged behind and won, 0.8 would have lost one."""

_AS_MUCH = 0.01
"""Of a gain. Constants are tried in steps, and half a step off costs up to half of this; and each is the best of many.
From 0.5 to 2 % the names that are lost either way are as few as they get."""

_APART = 2.0
"""t of the difference of two gains from which on stretches tell them apart, as small as the difference may be; as long
as it is no matter of constants, which the F test of one more of them says."""

_STARTS = 6
"""Values of a grid from which constants are searched for: their error has several valleys. The best was reached from
these in 177 of 181 cases, from half as many in 161."""

Choice = tuple[JudgedCandidate, tuple[JudgedCandidate, ...]]
"""A finding by its name, and its equals."""


def settled(
    model: Model,
    pool: Pool,
    state: State,
    choice: Choice,
    judged: Sequence[JudgedCandidate],
    products: Callable[[Pool], PhasedProducts],
) -> Choice:
    """The finding by the name that it has on equal terms, and its equals.

    The name stays as long as another does not say more in nearly every draw of the stretches.

    Parameters
    ----------
    choice : what was chosen on the grid, and its equals
    judged : all candidates on the grid
    products : inner products of the columns of a pool
    """
    contenders = _contenders(choice[0], judged)
    if all(item.candidate.effect == choice[0].candidate.effect for item in contenders):
        return choice
    parents = {finer: item for item in [*contenders, choice[0]] for finer in between(item.candidate.choice)}
    finer = finer_pool(model, pool, state, list(parents))
    data = products(finer)
    # With those of each kind of rows apart: what is about joints that start has none in common with other friction.
    for rivals in _by_rows(data, finer):
        own = [one for one in finer.candidates if one.effect == choice[0].candidate.effect]
        choice = _weighed(data, finer, state, choice, list(dict.fromkeys([*own, *rivals])), parents)
    return choice


def _by_rows(data: PhasedProducts, finer: Pool) -> list[list[Candidate]]:
    """The candidates, those together that are about the same kinds of rows."""
    kinds: dict[tuple[bool, bool], list[Candidate]] = {}
    for one in finer.candidates:
        kinds.setdefault(data.kinds(one.columns), []).append(one)
    return list(kinds.values())


def _weighed(
    data: PhasedProducts,
    finer: Pool,
    state: State,
    choice: Choice,
    candidates: Sequence[Candidate],
    parents: Mapping[EffectChoice, JudgedCandidate],
) -> Choice:
    """The choice, or another name that says more of the rows that are equations for all of these candidates."""
    chosen = choice[0]
    beside = replace(state, base=tuple(range(finer.n_base)))
    each = [data.kinds(one.columns) for one in candidates]
    common = all(turns for turns, _ in each), all(starts for _, starts in each)
    again = judge_all(data, finer, beside.base, candidates, state.noise, kinds=common)
    # That something is there is what the test on the grid says; here it is asked what it is called.
    again = [replace(item, p=parents[item.candidate.choice].p) for item in again]
    told = choose(data, finer, beside, again)
    if told is None:
        return choice
    slim = choose(data, finer, beside, [item for item in again if _slimmer(state, item, told[0])])
    told = slim or told
    winner = parents.get(told[0].candidate.choice)
    if winner is None:
        return choice
    if winner.candidate.effect == chosen.candidate.effect:
        return replace(winner, p=chosen.p), choice[1]
    own = [item for item in again if item.candidate.effect == chosen.candidate.effect]
    before = max(own, key=lambda item: item.total_gain)
    if slim is None and share_found_again([told[0]], [before], data.moving.run) < FOUND_AGAIN:
        return choice
    equal = {item.candidate.effect: parents.get(item.candidate.choice) for item in told[1]}
    others = [item for effect, item in equal.items() if item is not None and effect != winner.candidate.effect]
    return replace(winner, p=chosen.p), tuple(others)


def _slimmer(state: State, slim: JudgedCandidate, other: JudgedCandidate) -> bool:
    """Whether a name with fewer constants says as much; what robots seldom get from day to day is no better for it."""
    return slim.freedom < other.freedom and says_as_much(slim, other) and not is_seldom_change(state, slim)


def says_as_much(slim: JudgedCandidate, other: JudgedCandidate) -> bool:
    """Whether a candidate gains as much as one with more constants, each of which is the best of many."""
    less = other.total_gain - slim.total_gain
    told_apart = t_of(other.gains - slim.gains) >= _APART and _is_no_constant(less, other)
    return (less <= _AS_MUCH * other.total_gain and not told_apart) or indistinguishable(other, slim)


def _is_no_constant(more: float, other: JudgedCandidate) -> bool:
    """Whether a name gains more than a constant does that is fitted to what it leaves, by chance.

    A stretch counts as one sample. That constants are the best of many is why t alone says too much.
    """
    stretches = len(other.gains)
    return more * (stretches - 1) >= float(fdtri(1, stretches - 1, 1.0 - ALPHA)) * float(other.after_weighted.sum())


def _contenders(chosen: JudgedCandidate, judged: Sequence[JudgedCandidate]) -> list[JudgedCandidate]:
    """The best candidates of every effect that gains nearly as much on joints of the chosen one, its own among them."""
    mine = chosen.candidate
    near = [
        item
        for item in sorted(judged, key=lambda item: -item.total_gain)
        if item.candidate.runs == mine.runs
        and not set(item.joints).isdisjoint(chosen.joints)
        and item.total_gain >= _CONTENDS * chosen.total_gain
    ]
    found: list[JudgedCandidate] = []
    for effect in dict.fromkeys(item.candidate.effect for item in near):
        own = [item for item in near if item.candidate.effect == effect]
        same = [item for item in own if item.candidate.joints == mine.joints]
        joints = (same or own)[0].candidate.joints
        found += [item for item in own if item.candidate.joints == joints][:_STARTS]
    return found


def starts(judged: Sequence[JudgedCandidate]) -> list[JudgedCandidate]:
    """The candidates from which constants between those of the grid are searched for: the best few of every effect."""
    best = sorted(judged, key=lambda item: -item.total_gain)
    effects = dict.fromkeys(item.candidate.effect for item in best)
    return [item for name in effects for item in [one for one in best if one.candidate.effect == name][:_STARTS]]


def finer_pool(model: Model, pool: Pool, state: State, choices: Sequence[EffectChoice]) -> Pool:
    """The columns of the search so far and, behind them, these choices."""
    base = [pool.observation.columns[k] for k in state.base]
    return replace(pool_of(model, choices, base), since=pool.since)
