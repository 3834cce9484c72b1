"""A robot over many days as tables for people."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from rich.console import Console

from dynident.diagnosis.series import Course, Series, SeriesChange
from dynident.reports.change_rows import COLUMNS, change_rows
from dynident.reports.numbers import number
from dynident.robot import Robot
from dynident_service.cli.shown import choice_text
from dynident_service.cli.terminal import table


def show_series(console: Console, found: Series, robot: Robot) -> None:
    """What changed and when, and the course of what did; of all else the file has it."""
    console.print(found.summary, markup=False, style="bold")
    rows = [[when(one, found.days), *row] for one in found.changes for row in change_rows(one.change, robot)]
    if rows:
        console.print(table("Changes", ("from", *COLUMNS), rows, right_from=4))
    changed = {
        (one.change.choice.effect, joint) for one in found.changes for joint in one.change.choice.joints or ("",)
    }
    courses = [course for course in found.courses if (course.effect, course.joint) in changed]
    if courses:
        console.print(_courses(courses, found.days))
    for one in found.changes:
        doubt = f" This data cannot tell it from: {', '.join(one.change.equivalent)}." if one.change.equivalent else ""
        console.print(f"  {one.change.evidence}{doubt}", markup=False)
    if found.missing:
        both = "; ".join(choice_text(choice, robot) for choice in found.missing)
        console.print(f"  Missing in the model on all days: {both}", markup=False)


def when(one: SeriesChange, days: Sequence[str]) -> str:
    """The day from which something differs, with those that the data cannot tell from it."""
    if one.earliest == one.latest:
        return days[one.since]
    return f"{days[one.since]} ({days[one.earliest]} to {days[one.latest]})"


def _courses(courses: Sequence[Course], days: Sequence[str]) -> object:
    rows = []
    for k, day in enumerate(days):
        cells = [_cell(course.values[k], course.intervals[k]) for course in courses]
        rows.append([day, *cells])
    names = [f"{course.parameter}, {course.unit}" for course in courses]
    return table("Day by day, ± half of the 95 % interval", ("day", *names), rows, right_from=1)


def _cell(value: float, interval: np.ndarray) -> str:
    if not np.isfinite(value):
        return "not determined"
    return f"{number(float(value))} ± {number(float(interval[1] - value))}"
