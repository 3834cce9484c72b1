"""The changes of a robot: every difference, and that of each joint's friction, with its interval."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis import Change, FrictionDifference
from dynident.effects import get_effect
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
from dynident.reports.number_format import format_number

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
    axes.set_xlabel("difference (% of what it was)", fontsize=8)
    set_panel_title(axes, "Friction of each joint since the baseline, at its mean speed")
    words = [
        f"{difference.joint} {format_number(100.0 * difference.value / difference.before)} %" for difference in drawn
    ]
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
    room = _AXIS_MARGIN * (max(span) - min(span) or 1.0)
    axes.set_xlim(min(span) - room, max(span) + room)
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
