"""A robot over many days: what changed, from which day on, and every parameter's course."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from dynident.diagnosis.changed_values import Estimates, changes_at
from dynident.diagnosis.search.state import Finding
from dynident.diagnosis.series.courses import courses
from dynident.diagnosis.series.day_to_day import widened
from dynident.diagnosis.series.days import Day, Measure
from dynident.diagnosis.series.result import Series, SeriesChange
from dynident.diagnosis.series.searching import first_day, found_changes
from dynident.diagnosis.series.steps import Stepped, reduction_of, stepped_pool, stepped_products
from dynident.diagnosis.words import rank_all
from dynident.effects import effect_by_id
from dynident.errors import DynidentError
from dynident.estimation import statistics, weighted, weighted_factor
from dynident.progress import Progress, part, silent
from dynident.threads import single_threaded

FEWEST_DAYS = 2
_DEPENDENT = 1e-6


@single_threaded
def series(measure: Measure, days: Sequence[Day], progress: Progress = silent) -> Series:
    """Say what has changed in a robot over a series of days, in their order, and since when.

    The first day is what all others are compared with; the motions may differ. No recording is read: one more day costs
    its own reduction and this.

    Parameters
    ----------
    measure : Measure
        Of the model (`what_may_change`).
    days : sequence of Day
        Reduced to the measure's columns (`measured`), with names of their own.

    Raises
    ------
    DynidentError
        Where there are fewer than two days, two of one name, or days that are not of this measure.
    """
    names = tuple(day.name for day in days)
    _check(measure, days, names)
    pool, columns = stepped_pool(measure, names)
    data = stepped_products(days, columns)
    floor = np.sqrt(np.mean([day.floor**2 for day in days], axis=0))
    picks = found_changes(data, pool, floor, part(progress, 0.0, 0.6))
    numbers = list(range(pool.n_base)) + sorted({k for pick in picks for k in pick.columns})
    numbers += _companions(measure, picks, numbers, names, columns)
    numbers = _independent(days, columns, numbers)
    steps = [columns[k] for k in numbers]
    reduction = reduction_of(days, steps)
    solution = weighted(reduction)
    estimates = Estimates(
        measure.model.robot,
        tuple(pool.observation.columns[k] for k in numbers),
        solution.values,
        statistics(reduction, solution),
    )
    choices = [pick.judged.candidate.choice for pick in picks]
    ranked = rank_all(picks, (), choices)
    found: list[SeriesChange] = []
    for pick, one in zip(picks, ranked, strict=True):
        if pool.is_change(pick.judged.candidate):
            since = first_day(pick.judged.candidate, len(names))
            as_well = [since, *_days_as_well(pick, len(names))]
            found += [SeriesChange(c, since, min(as_well), max(as_well)) for c in changes_at(estimates, pick, one)]
    told = courses(days, measure.observation.columns, steps, part(progress, 0.6, 1.0))
    missing = tuple(choice for choice in choices if not choice.runs)
    progress(1.0, "compared")
    changes = widened(sorted(found, key=lambda one: one.since), told)
    return Series(names, changes, missing, told, _summary(changes, names))


def _check(measure: Measure, days: Sequence[Day], names: Sequence[str]) -> None:
    if len(days) < FEWEST_DAYS:
        raise DynidentError("a series takes two days at least", pointer="/days", title="Too few days")
    if len(set(names)) < len(names):
        twice = next(name for name in names if list(names).count(name) > 1)
        raise DynidentError(f"two days are called {twice!r}; give each a name of its own", pointer="/days")
    for day in days:
        if day.measure != measure.digest:
            raise DynidentError(f"day {day.name!r} was reduced for another model; reduce it again", pointer="/days")


def _companions(
    measure: Measure,
    picks: Iterable[Finding],
    there: Sequence[int],
    names: Sequence[str],
    columns: Sequence[Stepped],
) -> list[int]:
    """Columns of what usually changes along: else a value makes up for what was too small to be a finding."""
    known = {choice.effect for choice in measure.model.effects}
    wanted: list[int] = []
    for pick in picks:
        choice = pick.judged.candidate.choice
        if not choice.runs:
            continue
        since = first_day(pick.judged.candidate, len(names))
        others = set(effect_by_id(choice.effect).changes_with) & known
        for possible in measure.possible:
            one = possible.choice
            if one.effect in others and len(one.joints) == 1 and one.joints[0] in choice.joints:
                wanted += [columns.index(Stepped(k, since)) for k in possible.columns]
    return [k for k in dict.fromkeys(wanted) if k not in there]


def _days_as_well(pick: Finding, count: int) -> list[int]:
    """Days from which on the same change explains as much."""
    mine = pick.judged.candidate
    return [
        first_day(other, count)
        for other in (item.candidate for item in pick.equal)
        if (other.effect, other.joints, other.shape) == (mine.effect, mine.joints, mine.shape) and other.runs
    ]


def _independent(days: Sequence[Day], columns: Sequence[Stepped], numbers: Sequence[int]) -> list[int]:
    """Those columns that do not follow from the ones before them: of a mass on a link, the base parameters."""
    factor = weighted_factor(reduction_of(days, [columns[k] for k in numbers]), np.ones(len(days[0].floor)))[:-1, :-1]
    own = np.abs(np.diag(factor)) > _DEPENDENT * np.linalg.norm(factor, axis=0)
    return [k for k, kept in zip(numbers, own, strict=True) if kept]


def _summary(found: Sequence[SeriesChange], names: Sequence[str]) -> str:
    if not found:
        return f"Nothing that these recordings can show has changed from {names[0]} to {names[-1]}."
    parts = []
    for one in found:
        choice, main = one.change.choice, one.change.main
        place = f" on {choice.joints[0]}" if choice.joints else ""
        unit = "" if main.unit == "-" else f" {main.unit}"
        when = names[one.since]
        if one.earliest < one.latest:
            when = f"{names[one.since]} ({names[one.earliest]} to {names[one.latest]} fit as well)"
        title = effect_by_id(choice.effect).title
        parts.append(f"from {when} on: {title}{place} ({main.parameter} {main.value:+.3g}{unit})")
    return f"Changed since {names[0]}: {'; '.join(parts)}."
