"""Choose which candidate that passes is added: the simplest that explains as much, on the joints that gain."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from dynident.array_types import IndexArray
from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import ScoredCandidate, has_larger_gain, select_simplest
from dynident.diagnosis.decision_levels import RULES
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search.acceptance_rules import (
    compute_stability,
    find_rejection,
    has_gain_on_joint,
    is_other_name,
)
from dynident.diagnosis.search.physical_plausibility import find_impossibility
from dynident.diagnosis.search.search_state import State, score_all
from dynident.effects import get_effect
from dynident.estimation.residual_errors import compute_t


def select_candidate(
    state: State,
    judged: Sequence[ScoredCandidate],
    rejections: dict[Candidate, Reason] | None = None,
) -> tuple[ScoredCandidate, tuple[ScoredCandidate, ...]] | None:
    """Select the next effect to add and its equals on these data; None where nothing passes.

    What nature does not allow is never named.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    judged : sequence of ScoredCandidate
        Candidates, scored beside the model so far.
    rejections : dict of Candidate to Reason, optional
        Filled with the reason of every candidate that is rejected.

    Returns
    -------
    tuple of ScoredCandidate, tuple of ScoredCandidate, or None
        The effect, and what the data cannot tell from it.
    """
    reasons = {} if rejections is None else rejections
    large = []
    for scored in judged:
        rejection = find_rejection(state, scored)
        if rejection is None:
            large.append(scored)
        else:
            reasons[scored.candidate] = rejection
    # Physics is checked last and once for each, since it takes a fit of the model with the candidate.
    passing = []
    for scored in large:
        impossibility = find_impossibility(state, scored)
        if impossibility is None:
            passing.append(scored)
        else:
            reasons[scored.candidate] = impossibility
    doubted: list[ScoredCandidate] = []
    moving_scores: dict[Candidate, ScoredCandidate] = {}
    while passing:
        best, equal = select_simplest(passing)
        lasting = _find_lasting_cause(state, best, passing)
        chosen, equal = (lasting, (best, *equal)) if lasting else (best, equal)
        others = [
            scored
            for scored in [*passing, *doubted]
            if is_other_name(chosen, scored) and not _is_part_of_change(chosen, scored)
        ]
        if lasting:
            # Wear that warmth or a load says is no rival to it.
            others = [scored for scored in others if not state.pool.is_change(scored.candidate)]
        chosen, twins = _prefer_usual_change(state, chosen, _find_twins(chosen, others, state.data.moving.run))
        beyond = [scored for scored in others if all(scored is not twin for twin in twins)]
        equal = (*(scored for scored in equal if scored is not chosen), *(twin for twin in twins if twin not in equal))
        stability = _compute_stability(state, (chosen, *twins), beyond)
        if stability >= state.rules.found_again:
            slim = drop_idle_joints(state, chosen)
            # A single joint that is left of a group has to stand by itself.
            whole = slim is chosen or len(slim.candidate.joints) > 1
            by_itself = None if whole else find_rejection(state, replace(slim, p=chosen.p))
            # Where one only shows at reversals many may: the second one is scored together with all that are left.
            rejection = by_itself or check_moving_joints(state, slim, passing if moving_scores else (), moving_scores)
            if rejection is None:
                return replace(slim, p=chosen.p), equal + find_richer_changes(state, slim, passing, equal)
        else:
            rejection = Reason.build("unstable", share=stability, least=state.rules.found_again)
            # What takes its place in other draws would be no surer a name for want of it.
            doubted.append(best)
        # The best one has no sure name; the search goes on with the others.
        reasons[best.candidate] = rejection
        passing = [scored for scored in passing if scored is not best]
    return None


def _find_twins(chosen: ScoredCandidate, others: Sequence[ScoredCandidate], run: IndexArray) -> list[ScoredCandidate]:
    """Find other names for the same finding: as much of the error on the same joints and runs, and no draw decides."""
    mine, runs = set(chosen.joints), chosen.candidate.runs

    def is_undecided(scored: ScoredCandidate) -> bool:
        level = abs(compute_t(chosen.gains - scored.gains)) < RULES.equal_t
        return level or compute_stability([chosen], [scored], run) < RULES.found_again

    alike = [scored for scored in others if scored.candidate.runs == runs and not mine.isdisjoint(scored.joints)]
    return [
        scored for scored in alike if scored.total_gain >= RULES.equal_gain * chosen.total_gain and is_undecided(scored)
    ]


def _find_lasting_cause(
    state: State, chosen: ScoredCandidate, passing: Sequence[ScoredCandidate]
) -> ScoredCandidate | None:
    """Find a dependence on warmth, or on a load that was added, that explains as much as a change: that is no wear."""
    if not state.pool.is_change(chosen.candidate):
        return None
    is_loaded = get_effect(chosen.candidate.effect).is_friction and any(
        get_effect(finding.judged.candidate.effect).in_some_runs
        and finding.judged.candidate.runs == chosen.candidate.runs
        for finding in state.findings
    )
    # An arm gets warm as a whole: warmth of more joints explains a change on any of them.
    places = set(chosen.candidate.joints)
    lasting = [
        scored
        for scored in passing
        if (_is_warmth(scored) or (is_loaded and _grows_with_load(scored)))
        and places <= set(scored.candidate.joints)
        and bool(places) == bool(scored.candidate.joints)
        and scored.total_gain >= state.rules.as_much_as_change * chosen.total_gain
    ]
    return max(lasting, key=lambda scored: scored.total_gain, default=None)


def _is_part_of_change(chosen: ScoredCandidate, scored: ScoredCandidate) -> bool:
    """Return whether a change is reported with the chosen one: friction grows in all its parts, and is one finding."""
    mine, other = chosen.candidate, scored.candidate
    together = get_effect(mine.effect).changes_with
    return bool(mine.runs) and other.effect in together and (other.runs, other.joints) == (mine.runs, mine.joints)


def _is_warmth(scored: ScoredCandidate) -> bool:
    effect = get_effect(scored.candidate.effect)
    return effect.needs_temperature or effect.needs_session


def _grows_with_load(scored: ScoredCandidate) -> bool:
    effect = get_effect(scored.candidate.effect)
    return effect.is_friction and effect.needs_load and not scored.candidate.runs


def check_moving_joints(
    state: State,
    chosen: ScoredCandidate,
    more: Sequence[ScoredCandidate] = (),
    known: dict[Candidate, ScoredCandidate] | None = None,
) -> Reason | None:
    """Check that what remembers the path also lowers the error where joints move on, not only where they reverse.

    There soft gears and clocks leave something like it, and the error that is told is that of the other rows.

    Parameters
    ----------
    state : State
        The model so far and what was found.
    chosen : ScoredCandidate
        The candidate to check.
    more : sequence of ScoredCandidate
        Candidates that may be checked next, without their idle joints: they are scored together.
    known : dict of Candidate to ScoredCandidate, optional
        Scores without the rows where joints reverse; filled with those that are computed.
    """
    known = {} if known is None else known
    turns, starts = state.data.find_row_kinds(chosen.candidate.columns)
    if not turns:
        return None
    if chosen.candidate not in known:
        parts = [_remove_idle_joints(state, other) for other in more]
        alike = [part for part in parts if state.data.find_row_kinds(part.columns) == (turns, starts)]
        together = [part for part in dict.fromkeys([chosen.candidate, *alike]) if part not in known]
        known.update(zip(together, score_all(state, together, kinds=(False, starts)), strict=True))
    scored = known[chosen.candidate]
    if scored.error_drop >= state.rules.least_error_drop:
        return None
    return Reason.build("only_at_reversals", share=max(scored.error_drop, 0.0), least=state.rules.least_error_drop)


def _prefer_usual_change(
    state: State, chosen: ScoredCandidate, twins: list[ScoredCandidate]
) -> tuple[ScoredCandidate, list[ScoredCandidate]]:
    """Return the name of a finding that robots usually get from one day to the next, and the others."""
    seldom = is_seldom_change(state, chosen)
    usual = [scored for scored in twins if state.pool.is_change(scored.candidate) and not _is_seldom(scored)]
    if not (seldom and usual):
        return chosen, twins
    best = max(usual, key=lambda scored: scored.total_gain)
    return best, [chosen, *(scored for scored in twins if scored is not best)]


def is_seldom_change(state: State, scored: ScoredCandidate) -> bool:
    """Return whether a candidate is a change of the later runs that robots seldom get from one day to the next."""
    return state.pool.is_change(scored.candidate) and _is_seldom(scored)


def _is_seldom(scored: ScoredCandidate) -> bool:
    return get_effect(scored.candidate.effect).seldom_changes


def _compute_stability(state: State, names: Sequence[ScoredCandidate], passing: Sequence[ScoredCandidate]) -> float:
    """Return the share of resampled data in which the same finding, by any of its names, is made.

    Another finding beside it is none that could take its place.
    """
    others = [scored for scored in passing if all(is_other_name(name, scored) for name in names)]
    run, chosen = state.data.moving.run, names[0]
    share = compute_stability(names, others, run)
    if share >= state.rules.found_again:
        return share
    beside = replace(state, base=state.base + chosen.candidate.columns)
    # Only names of the same thing are rivals: beside the chosen effect nothing of them is left.
    rescored = score_all(beside, [scored.candidate for scored in others])
    rivals = [
        before
        for before, after in zip(others, rescored, strict=True)
        if after.total_gain < state.rules.still_gains * before.total_gain
    ]
    return compute_stability(names, rivals, run)


def find_richer_changes(
    state: State,
    chosen: ScoredCandidate,
    passing: Sequence[ScoredCandidate],
    equivalents: Sequence[ScoredCandidate],
) -> tuple[ScoredCandidate, ...]:
    """Find other changes that explain more on the same joints with more parameters, though not surely more.

    The simpler name stands, but what changed may as well be this: a base that leans, of which an offset says the most.
    """
    if not state.pool.is_change(chosen.candidate):
        return ()
    known = {scored.candidate.effect for scored in (chosen, *equivalents)}
    richer: dict[str, ScoredCandidate] = {}
    for scored in sorted(passing, key=lambda scored: -scored.total_gain):
        same = scored.candidate.runs == chosen.candidate.runs and set(chosen.joints) <= set(scored.joints)
        if scored.candidate.effect not in known and same and scored.total_gain >= chosen.total_gain:
            richer.setdefault(scored.candidate.effect, scored)
    return tuple(scored for scored in richer.values() if not has_larger_gain(scored, chosen))


def drop_idle_joints(state: State, chosen: ScoredCandidate) -> ScoredCandidate:
    """Take joints out of a group that gain nothing from it, or that only stick: by themselves they slip at once."""
    smaller = _remove_idle_joints(state, chosen)
    return chosen if smaller is chosen.candidate else score_all(state, [smaller])[0]


def _remove_idle_joints(state: State, chosen: ScoredCandidate) -> Candidate:
    """Return a candidate on those of its joints that gain from it; the same where all or none do."""
    if len(chosen.candidate.joints) < 2:
        return chosen.candidate
    # The gain from a passive joint shows in the torque of the joint that moves it.
    movers = state.pool.observation.robot.get_movers
    gaining = [name for name in chosen.candidate.joints if has_gain_on_joint(state, chosen, movers(name)[0])]
    if not gaining or len(gaining) == len(chosen.candidate.joints):
        return chosen.candidate
    columns = tuple(k for k in chosen.candidate.columns if state.pool.observation.columns[k].link in gaining)
    return Candidate(chosen.candidate.effect, tuple(gaining), chosen.candidate.shape, columns, chosen.candidate.runs)
