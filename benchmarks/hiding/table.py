"""The table that the benchmark prints, and the cases behind its failures."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterable, Sequence
from typing import TypeVar

from hiding.outcome import Outcome

T = TypeVar("T")

_HEAD = (
    "", "cases", "show", "first", "equiv", "three", "joint", "wrong", "none", "both", "beside", "extra", "unknown",
    "error ratio", "par. err", "excess", "s",
)  # fmt: skip


def table(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """Rows of the table: a family a row, then totals by kind and size, then single cases by how they were recorded.

    Shares are of the cases that show; `beside`, `extra` and `unknown` of all.
    """
    rows: list[tuple[str, ...]] = [_HEAD]
    singles = [o for o in outcomes if o.kind == "single"]
    families = dict.fromkeys(o.effects[0] for o in singles)
    sizes = dict.fromkeys(o.size for o in singles)
    rows += [_row(family, [o for o in singles if o.effects[0] == family]) for family in families]
    rows += [_row(f"all single, {size}", [o for o in singles if o.size == size]) for size in sizes]
    rows += [_row(f"all {kind}", [o for o in outcomes if o.kind == kind]) for kind in ("double", "outside", "clean")]
    rows += _by_recording(singles)
    return [row for row in rows if row[1] != "0"]


def _by_recording(outcomes: Sequence[Outcome]) -> list[tuple[str, ...]]:
    """A row for every motion, controller and rate, where there are several."""
    of: tuple[Callable[[Outcome], str], ...] = (
        lambda o: o.recorded.motion,
        lambda o: f"{o.recorded.controller} controller",
        lambda o: f"{o.recorded.rate:g} Hz",
    )
    rows = []
    for title_of in of:
        titles = dict.fromkeys(title_of(o) for o in sorted(outcomes, key=lambda o: -o.recorded.rate))
        if len(titles) > 1:
            rows += [_row(f"  {title}", [o for o in outcomes if title_of(o) == title]) for title in titles]
    return rows


def totals(outcomes: Sequence[Outcome]) -> dict[str, float]:
    """The numbers that matter, as shares; NaN where there is no such case."""
    shown = [o for o in outcomes if o.shows and not o.failure]
    full = [o for o in shown if o.kind == "single" and o.size == "full"]
    quarter = [o for o in shown if o.kind == "single" and o.size == "quarter"]
    double = [o for o in shown if o.kind == "double"]
    outside = [o for o in shown if o.kind == "outside"]
    clean = [o for o in outcomes if o.kind == "clean" and not o.failure]
    ratios = [o.over_oracle for o in shown if o.over_oracle is not None and o.kind != "outside"]
    errors = [error for o in shown for _, error in o.parameter_errors]
    return {
        "right first, full": _share(full, _right),
        "right in three, full": _share(full, lambda o: o.in_three),
        "wrong name, full": _share(full, lambda o: o.naming == "wrong"),
        "right joint": _share([o for o in (*full, *quarter) if o.joint is not None], lambda o: bool(o.joint)),
        "right first, quarter": _share(quarter, _right),
        "wrong name, quarter": _share(quarter, lambda o: o.naming == "wrong"),
        "something beside": _share([*full, *quarter], lambda o: bool(o.beside)),
        "both of two": _share(double, lambda o: o.complete),
        "outside: unknown with its variable, or an equivalent": _share(outside, right_outside),
        "outside: wrong name": _share(outside, lambda o: bool(o.beside)),
        "extra names, all cases": _share([o for o in outcomes if not o.failure], lambda o: bool(o.extra)),
        "clean: something recommended": _share(clean, lambda o: bool(o.recommended)),
        "clean: something unknown": _share(clean, lambda o: bool(o.unknown)),
        "held-out error within 1.05 of the true structure": _share(ratios, lambda ratio: ratio <= 1.05),
        "worst held-out error over the true structure": max(ratios, default=float("nan")),
        "parameter error, median": statistics.median(errors) if errors else float("nan"),
        "parameter error within 3 %": _share(errors, lambda error: error <= 0.03),
        "below the noise, yet something recommended": _share(
            [o for o in outcomes if not o.shows and o.kind == "single" and not o.failure], lambda o: bool(o.beside)
        ),
        "failed": float(sum(bool(o.failure) for o in outcomes)),
    }


def right_outside(outcome: Outcome) -> bool:
    """Whether what no catalogue has was said to be unknown, with its variable, or given an equivalent's name."""
    return not outcome.beside and (outcome.unknown_right or outcome.naming == "right")


def is_failure(outcome: Outcome) -> bool:
    """Whether a case belongs on the list of failures."""
    if outcome.failure:
        return True
    if outcome.kind == "clean":
        return outcome.verdict != "adequate"
    if not outcome.shows:
        return bool(outcome.beside)
    if outcome.kind == "outside":
        return not right_outside(outcome)
    if outcome.kind == "double":
        return not outcome.complete or bool(outcome.beside)
    late = outcome.over_oracle is not None and outcome.over_oracle > 1.05
    return not _right(outcome) or outcome.joint is False or bool(outcome.beside) or late


def describe(outcome: Outcome) -> str:
    """A failure in enough detail to look for its cause."""
    how = outcome.recorded
    lines = [
        f"{outcome.case}: hidden on {', '.join(outcome.joints) or 'the whole robot'}, excess {outcome.excess:.2f}; "
        f"{how.motion}, {how.controller} controller, {how.rate:g} Hz, at {', '.join(f'{p:.0%}' for p in how.paces)}"
    ]
    if outcome.failure:
        return "\n".join([*lines, f"    {outcome.failure}"])
    oracle = "-" if outcome.oracle is None else f"{outcome.oracle:.3f}"
    lines.append(
        f"    {outcome.verdict}; held-out error over noise: plain {outcome.plain:.3f}, after {outcome.after:.3f}, "
        f"true structure {oracle}"
    )
    lines.append(f"    recommended: {'; '.join(outcome.recommended) or 'nothing'}")
    if outcome.unknown:
        lines.append(f"    unknown: {'; '.join(outcome.unknown)}")
    for hint in outcome.hints:
        twins = f" = {', '.join(hint.equivalent)}" if hint.equivalent else ""
        lines.append(f"    {'*' if hint.significant else ' '} {hint.effect}{twins}: {hint.evidence}")
    return "\n".join(lines)


def _row(title: str, outcomes: Sequence[Outcome]) -> tuple[str, ...]:
    worked = [o for o in outcomes if not o.failure]
    shown = [o for o in worked if o.shows or o.kind == "clean"]
    ratios = [o.over_oracle for o in shown if o.over_oracle is not None]
    errors = [error for o in shown for _, error in o.parameter_errors]
    clean = all(o.kind == "clean" for o in outcomes)
    first = right_outside if all(o.kind == "outside" for o in outcomes) else _right
    return (
        title + ("" if all(o.known or o.kind == "outside" for o in outcomes) else " (not in the catalogue)"),
        str(len(outcomes)),
        str(len(shown)),
        "-" if clean else _count(shown, first),
        "-" if clean else _count(shown, lambda o: o.naming == "equivalent"),
        "-" if clean else _count(shown, lambda o: o.in_three),
        _count([o for o in shown if o.joint is not None], lambda o: bool(o.joint)),
        _count(shown, lambda o: o.naming == "wrong"),
        _count(shown, lambda o: o.naming == "none"),
        _count([o for o in shown if o.kind == "double"], lambda o: o.complete),
        _count(worked, lambda o: bool(o.beside)),
        _count(worked, lambda o: bool(o.extra)),
        _count(worked, lambda o: bool(o.unknown)),
        f"{statistics.median(ratios):.3f} {max(ratios):.3f}" if ratios else "-",
        f"{statistics.median(errors):.1%} {max(errors):.1%}" if errors else "-",
        f"{statistics.median(o.excess for o in worked):.2f}" if worked else "-",
        f"{statistics.median(o.seconds for o in worked):.1f}" if worked else "-",
    )


def _right(outcome: Outcome) -> bool:
    return outcome.naming in ("right", "equivalent")


def _count(outcomes: Sequence[Outcome], test: Callable[[Outcome], bool]) -> str:
    return f"{sum(map(test, outcomes))}/{len(outcomes)}" if outcomes else "-"


def _share(items: Iterable[T], test: Callable[[T], bool]) -> float:
    values = [bool(test(item)) for item in items]
    return sum(values) / len(values) if values else float("nan")
