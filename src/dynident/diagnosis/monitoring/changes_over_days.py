"""Decide what changed over a series of days, and from which day on (`monitor_days`).

Holds the fewest days (2) and the most changes (12) of a series; tests each change for every first day.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis.candidates.candidate_pool import Candidate, Pool
from dynident.diagnosis.candidates.inner_product_accumulation import PhasedProducts
from dynident.diagnosis.candidates.significance import ScoredCandidate
from dynident.diagnosis.change_sizes import Estimates, yield_changes
from dynident.diagnosis.diagnosis_summary import rank_findings
from dynident.diagnosis.monitoring.parameter_tracks import (
    Series,
    SeriesChange,
    StepColumn,
    build_step_pool,
    combine_days,
    estimate_tracks,
    gather_step_products,
    widen_intervals,
)
from dynident.diagnosis.monitoring.reduced_days import Day, Measure
from dynident.diagnosis.search.identifiability_and_invisible_effects import is_determined
from dynident.diagnosis.search.next_finding import select_candidate
from dynident.diagnosis.search.pruning import prune_findings
from dynident.diagnosis.search.search_state import Finding, State, score_family
from dynident.effects import get_effect
from dynident.errors import DynidentError
from dynident.estimation import build_weighted_factor, solve_weighted, statistics
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress

_AS_MUCH = 0.9
"""Of what a change explains: what was there all along and says so much of it leaves no change."""

MOST_CHANGES = 12
"""A robot that differs in more is another robot on other days."""


def find_changes(data: PhasedProducts, pool: Pool, floor: FloatArray, progress: Progress) -> tuple[Finding, ...]:
    """Add the change that gains most, from the day from which it gains most, until none passes.

    Parameters
    ----------
    data : PhasedProducts
        Products of the days' columns, as of `gather_step_products`.
    pool : Pool
        Columns, and all changes from any day on as candidates.
    floor : (n,)
        Noise of the sensors, N m or N.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    tuple of Finding
        The changes that pass, without those that others make superfluous.
    """
    state = State(data, pool, tuple(range(pool.n_base)), floor, floor).estimate_noise()
    remaining: Sequence[Candidate] = pool.candidates
    firm = is_determined(state)
    while remaining and len(state.findings) < MOST_CHANGES:
        progress(len(state.findings) / MOST_CHANGES, f"{len(state.findings)} changes found")
        judged = score_family(state, remaining).scored
        # What explains as much on all days alike has not changed.
        unshadowed = [scored for scored in judged if not _is_shadow(scored, judged)]
        choice = select_candidate(state, [_judge_by_side(scored, state) for scored in unshadowed])
        if choice is None:
            break
        chosen, equal = choice
        state = state.add_finding(Finding(chosen, equal, chosen.p)).estimate_noise()
        # Where the motion does not determine the model, a gain may only be a better conditioned model. Then nothing is
        # named.
        firm = firm or is_determined(state)
        if not firm:
            return ()
        remaining = [candidate for candidate in remaining if not set(candidate.columns) <= set(state.base)]
    return prune_findings(state).findings


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


def _judge_by_side(scored: ScoredCandidate, state: State) -> ScoredCandidate:
    """Return a change judged by the better of two sides: the days before it, or the days from it on."""
    since = get_first_day(scored.candidate, len(state.pool.since) + 1)
    if not since:
        return scored
    # The runs of these products are the days.
    later = state.data.moving.run >= since
    # Of ten days, the last has a tenth of all the error: over all days even a complete change would explain little.
    sides = [replace(scored, before=scored.before[side], after=scored.after[side]) for side in (~later, later)]
    best = max(sides, key=_compute_drop)
    return replace(best, drop=max(scored.drop, _compute_drop(best)))


def _compute_drop(scored: ScoredCandidate) -> float:
    before, after = scored.before.sum(axis=0), scored.after.sum(axis=0)
    if len(scored.candidate.joints) > 1:
        before, after = before.sum(keepdims=True), after.sum(keepdims=True)
    return float(((before - after) / np.maximum(before, np.finfo(float).tiny)).max())


FEWEST_DAYS = 2
# Share of a column that has to be left beside those before it.
_DEPENDENT = 1e-6


@single_threaded
def monitor_days(measure: Measure, days: Sequence[Day], progress: Progress = ignore_progress) -> Series:
    """Find what has changed in a robot over a series of days, in their order, and since when.

    The first day is what all others are compared with; the motions may differ. No recording is read: one more day costs
    its own reduction and this.

    Parameters
    ----------
    measure : Measure
        Columns that the days were reduced to, as of `build_measure`.
    days : sequence of Day
        Days in their order, as of `reduce_day`, with names of their own.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    Series
        What changed and when, and every parameter day by day.

    Raises
    ------
    DynidentError
        Where there are fewer than two days, two of one name, or days that are not of this measure.
    """
    # The names of the days serve as labels of runs, so each must be there once.
    names = tuple(day.name for day in days)
    _check_days(measure, days, names)
    pool, columns = build_step_pool(measure, names)
    data = gather_step_products(days, columns)
    # Variances are averaged, not deviations: the noise of all days together is their root mean square.
    floor = np.sqrt(np.mean([day.floor**2 for day in days], axis=0))
    findings = find_changes(data, pool, floor, scale_progress(progress, 0.0, 0.6))
    # Model and findings in one fit, so that their values and intervals allow for each other.
    numbers = list(range(pool.n_base)) + sorted({k for finding in findings for k in finding.columns})
    # Friction grows in all its parts: where only one of them is a finding, its value must not make up for the others.
    numbers += _list_companions(measure, findings, numbers, names, columns)
    numbers = _select_independent(days, columns, numbers)
    steps = [columns[k] for k in numbers]
    reduction = combine_days(days, steps)
    solution = solve_weighted(reduction)
    estimates = Estimates(
        measure.model.robot,
        tuple(pool.observation.columns[k] for k in numbers),
        solution.values,
        statistics(reduction, solution),
    )
    choices = [finding.judged.candidate.choice for finding in findings]
    ranked = rank_findings(findings, choices)
    dated_changes: list[SeriesChange] = []
    for finding, ranked_effect in zip(findings, ranked, strict=True):
        if pool.is_change(finding.judged.candidate):
            since = get_first_day(finding.judged.candidate, len(names))
            as_well = [since, *_list_equivalent_days(finding, len(names))]
            dated_changes += [
                SeriesChange(c, since, min(as_well), max(as_well))
                for c in yield_changes(estimates, finding, ranked_effect)
            ]
    tracks = estimate_tracks(days, measure.observation.columns, steps, scale_progress(progress, 0.6, 1.0))
    missing = tuple(choice for choice in choices if not choice.runs)
    progress(1.0, "compared")
    changes = widen_intervals(sorted(dated_changes, key=lambda change: change.since), tracks)
    return Series(names, changes, missing, tracks, _word_summary(changes, names))


def _check_days(measure: Measure, days: Sequence[Day], names: Sequence[str]) -> None:
    if len(days) < FEWEST_DAYS:
        raise DynidentError("a series needs at least two days", pointer="/days", title="Too few days")
    if len(set(names)) < len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise DynidentError(f"two days have the name {twice!r}; give each day its own name", pointer="/days")
    for day in days:
        if day.measure != measure.digest:
            raise DynidentError(f"day {day.name!r} was reduced for another model; reduce it again", pointer="/days")


def _list_companions(
    measure: Measure,
    findings: Iterable[Finding],
    existing: Sequence[int],
    names: Sequence[str],
    columns: Sequence[StepColumn],
) -> list[int]:
    """Return columns that usually change along with the findings, and are too small to be findings themselves."""
    known = {choice.effect for choice in measure.model.effects}
    companions: list[int] = []
    for finding in findings:
        choice = finding.judged.candidate.choice
        if not choice.runs:
            continue
        since = get_first_day(finding.judged.candidate, len(names))
        others = set(get_effect(choice.effect).changes_with) & known
        for possible in measure.possible:
            other_choice = possible.choice
            if (
                other_choice.effect in others
                and len(other_choice.joints) == 1
                and other_choice.joints[0] in choice.joints
            ):
                companions += [columns.index(StepColumn(k, since)) for k in possible.columns]
    return [k for k in dict.fromkeys(companions) if k not in existing]


def _list_equivalent_days(finding: Finding, count: int) -> list[int]:
    """Return the days from which on the same change explains as much."""
    mine = finding.judged.candidate
    return [
        get_first_day(other, count)
        for other in (scored.candidate for scored in finding.equal)
        if (other.effect, other.joints, other.shape) == (mine.effect, mine.joints, mine.shape) and other.runs
    ]


def _select_independent(days: Sequence[Day], columns: Sequence[StepColumn], numbers: Sequence[int]) -> list[int]:
    """Return the columns that are no linear combination of those before them."""
    factor = build_weighted_factor(combine_days(days, [columns[k] for k in numbers]), np.ones(len(days[0].floor)))[
        :-1, :-1
    ]
    # The diagonal of the triangular factor is what each column adds to those before it.
    own = np.abs(np.diag(factor)) > _DEPENDENT * np.linalg.norm(factor, axis=0)
    return [k for k, is_independent in zip(numbers, own, strict=True) if is_independent]


def _word_summary(changes: Sequence[SeriesChange], names: Sequence[str]) -> str:
    if not changes:
        return f"These recordings show no change from {names[0]} to {names[-1]}."
    parts = []
    for change in changes:
        choice, main = change.change.choice, change.change.main
        place = f" on {choice.joints[0]}" if choice.joints else ""
        unit = "" if main.unit == "-" else f" {main.unit}"
        when = names[change.since]
        if change.earliest < change.latest:
            when = f"{names[change.since]} ({names[change.earliest]} to {names[change.latest]} fit equally well)"
        title = get_effect(choice.effect).title
        parts.append(f"from {when} on: {title}{place} ({main.parameter} {main.value:+.3g}{unit})")
    return f"Changed since {names[0]}: {'; '.join(parts)}."
