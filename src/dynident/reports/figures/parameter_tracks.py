"""Parameters day by day with their intervals, and the days on which they change."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis.monitoring import ParameterTrack, Series
from dynident.effects import EffectChoice, get_effect
from dynident.reports.figures.svg import MEASURED, PREDICTED, Margins, make_panels, set_panel_title, to_svg

_MAX_DRAWN_PARAMETERS = 2
"""Effects with at most so many parameters a joint are drawn with all of them."""


def draw_parameter_tracks(series: Series) -> Markup:
    """Draw the parameters that may vary: a row for each parameter, a column for each joint, changes in colour.

    Of an effect with more parameters, such as a mass, only the one is drawn that states how large the change is.

    Parameters
    ----------
    series : Series
        The parameters of all days and their changes.

    Returns
    -------
    Markup
        An inline SVG; empty where no parameter may vary.
    """
    main_parameters = {change.change.main.parameter for change in series.changes}
    varying = [course for course in series.courses if course.joint and course.varies]
    drawn = [course for course in varying if _has_few_parameters(course.effect) or course.parameter in main_parameters]
    rows = list(dict.fromkeys(_get_row_key(course) for course in drawn))
    joints = list(dict.fromkeys(course.joint for course in drawn))
    if not drawn:
        return Markup("")
    figure, grid = make_panels(len(rows), len(joints), 1.5, margins=Margins(left=0.55, bottom=0.62), gap=0.42)
    # Not every joint has every parameter. Panels without one stay invisible.
    for axes in chain.from_iterable(grid):
        axes.set_visible(False)
    for course in drawn:
        axes = grid[rows.index(_get_row_key(course))][joints.index(course.joint)]
        axes.set_visible(True)
        _draw_track(
            axes, course, [change.since for change in series.changes if _concerns(course, change.change.choice)]
        )
    for k in range(len(joints)):
        visible = [row[k] for row in grid if row[k].get_visible()]
        _name_days(visible[-1], series.days)
    return to_svg(
        figure, f"{len(drawn)} parameters over {len(series.days)} days, with 95 % intervals. {series.summary}"
    )


def _has_few_parameters(effect: str) -> bool:
    return len(get_effect(effect).parameters) <= _MAX_DRAWN_PARAMETERS


def _get_row_key(course: ParameterTrack) -> tuple[str, str]:
    """Return effect and parameter without the joint's number, by which parameters share a row."""
    return course.effect, course.parameter.rstrip("0123456789")


def _concerns(course: ParameterTrack, choice: EffectChoice) -> bool:
    return choice.effect == course.effect and course.joint in choice.joints


def _draw_track(axes: Axes, course: ParameterTrack, since: Sequence[int]) -> None:
    days = np.arange(len(course.values))
    # A day whose motion does not determine the parameter has no value.
    determined = np.isfinite(course.values)
    # From the first change on the colour is another one; further changes are lines alone.
    later = days >= min(since, default=len(days))
    for subset, colour in ((determined & ~later, MEASURED), (determined & later, PREDICTED)):
        if subset.any():
            half = course.values[subset] - course.intervals[subset, 0]
            axes.errorbar(
                days[subset], course.values[subset], half, fmt="o", markersize=3, linewidth=1, color=colour, capsize=0
            )
    # The line stands between the last day before the change and the first day after it.
    for day in since:
        axes.axvline(day - 0.5, color=PREDICTED, linewidth=0.9, linestyle=(0, (4, 3)))
    axes.set_xlim(-0.6, len(days) - 0.4)
    axes.set_xticks(days, [""] * len(days))
    unit = "" if course.unit == "-" else f" ({course.unit})"
    set_panel_title(axes, f"{course.parameter}{unit}")


def _name_days(axes: Axes, names: Sequence[str]) -> None:
    """Write names of days under the last panel of a column, as many as there is room for."""
    every = max(1, -(-len(names) // 5))
    labels = [name[-10:] if k % every == 0 else "" for k, name in enumerate(names)]
    axes.set_xticks(range(len(names)), labels, rotation=40, ha="right", fontsize=7)
