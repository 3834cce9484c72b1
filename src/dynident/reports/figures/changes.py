"""Figures of changes: each difference with its interval, and parameters day by day."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis import Change, FrictionDifference
from dynident.diagnosis.monitoring import ParameterTrack, Series
from dynident.effects import EffectChoice, get_effect
from dynident.number_format import format_number, format_percent
from dynident.reports.figures.svg import (
    BAND,
    MEASURED,
    PREDICTED,
    Margins,
    make_panels,
    set_panel_title,
    shorten_name,
    to_svg,
)

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


_FRICTION_ROW_HEIGHT, _FRICTION_HEAD_HEIGHT = 0.26, 0.35


def draw_friction_differences(friction: Sequence[FrictionDifference]) -> Markup | None:
    """Draw the difference of each joint's friction in per cent of what it was, with its 95 % interval.

    A difference is in colour where its interval does not cover zero.

    Parameters
    ----------
    friction : sequence of FrictionDifference
        Differences, one a joint.

    Returns
    -------
    Markup or None
        An inline SVG; None where no joint had friction before.
    """
    drawn = [difference for difference in friction if difference.before > 0.0]
    if not drawn:
        return None
    margins = Margins(left=2.2, right=0.3, bottom=0.5)
    figure, grid = make_panels(1, 1, _FRICTION_HEAD_HEIGHT + _FRICTION_ROW_HEIGHT * len(drawn), margins=margins)
    axes = grid[0][0]
    for row, difference in enumerate(drawn):
        value, low, high = (100.0 * end / difference.before for end in (difference.value, *difference.interval))
        # Grey where the interval covers zero: there the data show no change.
        colour = MEASURED if low <= 0.0 <= high else PREDICTED
        axes.barh(row, high - low, left=low, height=0.5, color=BAND, alpha=0.5, linewidth=0)
        axes.plot([value], [row], marker="o", color=colour, markersize=5, linewidth=0)
    axes.axvline(0.0, color="#4d4d4d", linewidth=0.9)
    # The axis points down, so that the first joint stands at the top.
    axes.set_ylim(len(drawn) - 0.5, -0.5)
    axes.set_yticks(range(len(drawn)))
    axes.set_yticklabels([shorten_name(difference.joint) for difference in drawn], parse_math=False)
    # Bars otherwise pin the axis to their own ends, without a margin.
    axes.use_sticky_edges = False
    axes.set_xlabel("difference (% of the value before)", fontsize=8)
    set_panel_title(axes, "Friction of each joint since the baseline, at its mean speed")
    words = [f"{difference.joint} {format_percent(difference.value / difference.before)}" for difference in drawn]
    return to_svg(figure, f"Friction since the baseline with intervals of 95 %. {'; '.join(words)}.")


_CHANGE_HEIGHT = 0.92
_AXIS_MARGIN = 0.15


def draw_changes(changes: Sequence[Change]) -> Markup:
    """Draw every change with its 95 % interval, each on an axis of its own unit.

    Parameters
    ----------
    changes : sequence of Change
        At least one.

    Returns
    -------
    Markup
        An inline SVG.
    """
    figure, grid = make_panels(len(changes), 1, _CHANGE_HEIGHT, margins=Margins(left=0.3, right=0.3, bottom=0.3))
    for [axes], change in zip(grid, changes, strict=True):
        _draw_change(axes, change)
    words = [f"{_format_title(change)} {format_number(change.main.value)} {_format_unit(change)}" for change in changes]
    return to_svg(figure, f"Differences since the baseline with their intervals of 95 %. {'; '.join(words)}.")


def _draw_change(axes: Axes, change: Change) -> None:
    value, (low, high) = change.main.value, change.main.interval
    axes.barh(0.0, high - low, left=low, height=0.5, color=BAND, alpha=0.5, linewidth=0)
    axes.plot([value], [0.0], marker="o", color=PREDICTED, markersize=6, linewidth=0)
    axes.axvline(0.0, color="#4d4d4d", linewidth=0.9)
    # Zero belongs to the axis: whether the interval covers it decides whether there is a change at all.
    span = (0.0, value, low, high)
    margin = _AXIS_MARGIN * (max(span) - min(span) or 1.0)
    axes.set_xlim(min(span) - margin, max(span) + margin)
    axes.set_ylim(-0.5, 0.5)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    was = "" if change.main.before is None else f", {format_number(change.main.before)} before"
    set_panel_title(
        axes,
        f"{_format_title(change)}: {'+' if value > 0 else ''}{format_number(value)} {_format_unit(change)} "
        f"({format_number(low)} to {format_number(high)}{was})",
    )


def _format_title(change: Change) -> str:
    place = f" on {', '.join(shorten_name(name) for name in change.choice.joints)}" if change.choice.joints else ""
    return f"{get_effect(change.choice.effect).title}{place}, {change.main.parameter}"


def _format_unit(change: Change) -> str:
    return "" if change.main.unit == "-" else change.main.unit
