"""Parameters day by day, with their intervals, and the days from which they differ."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis.series import Course, Series
from dynident.effects import EffectChoice, effect_by_id
from dynident.reports.figures.svg import MEASURED, PREDICTED, Margins, panel_title, panels, to_svg

_FEW = 2
"""Parameters of an effect on a joint that are all drawn."""


def courses_figure(found: Series) -> Markup:
    """A row for each parameter of a joint that may vary, a column for each joint; what changed in colour.

    Of an effect with many parameters, a mass, that one is drawn which says how large it is.
    """
    told = {one.change.main.parameter for one in found.changes}
    varying = [course for course in found.courses if course.joint and course.varies]
    drawn = [course for course in varying if _is_small(course.effect) or course.parameter in told]
    rows = list(dict.fromkeys(_kind(course) for course in drawn))
    joints = list(dict.fromkeys(course.joint for course in drawn))
    if not drawn:
        return Markup("")
    figure, grid = panels(len(rows), len(joints), 1.5, margins=Margins(left=0.55, bottom=0.62), gap=0.42)
    for axes in chain.from_iterable(grid):
        axes.set_visible(False)
    for course in drawn:
        axes = grid[rows.index(_kind(course))][joints.index(course.joint)]
        axes.set_visible(True)
        _draw(axes, course, [one.since for one in found.changes if _is_of(course, one.change.choice)])
    for k in range(len(joints)):
        shown = [row[k] for row in grid if row[k].get_visible()]
        _name_days(shown[-1], found.days)
    return to_svg(figure, f"{len(drawn)} parameters over {len(found.days)} days, with 95 % intervals. {found.summary}")


def _is_small(effect: str) -> bool:
    return len(effect_by_id(effect).parameters) <= _FEW


def _kind(course: Course) -> tuple[str, str]:
    return course.effect, course.parameter.rstrip("0123456789")


def _is_of(course: Course, choice: EffectChoice) -> bool:
    return choice.effect == course.effect and course.joint in choice.joints


def _draw(axes: Axes, course: Course, since: Sequence[int]) -> None:
    days = np.arange(len(course.values))
    there = np.isfinite(course.values)
    later = days >= min(since, default=len(days))
    for chosen, colour in ((there & ~later, MEASURED), (there & later, PREDICTED)):
        if chosen.any():
            half = course.values[chosen] - course.intervals[chosen, 0]
            axes.errorbar(
                days[chosen], course.values[chosen], half, fmt="o", markersize=3, linewidth=1, color=colour, capsize=0
            )
    for day in since:
        axes.axvline(day - 0.5, color=PREDICTED, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.set_xlim(-0.6, len(days) - 0.4)
    axes.set_xticks(days, [""] * len(days))
    unit = "" if course.unit == "-" else f" ({course.unit})"
    panel_title(axes, f"{course.parameter}{unit}")


def _name_days(axes: Axes, names: Sequence[str]) -> None:
    """Names under the last panel of a column, as many as there is room for."""
    every = max(1, -(-len(names) // 5))
    labels = [name[-10:] if k % every == 0 else "" for k, name in enumerate(names)]
    axes.set_xticks(range(len(names)), labels, rotation=40, ha="right", fontsize=7)
