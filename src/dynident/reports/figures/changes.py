"""The changes of a robot: every difference with its interval."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis import Change
from dynident.effects import effect_by_id
from dynident.reports.figures.svg import BAND, PREDICTED, Margins, panel_title, panels, shortened, to_svg
from dynident.reports.numbers import number

_ROW = 0.92
_ROOM = 0.15


def changes_figure(changes: Sequence[Change]) -> Markup:
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
    figure, grid = panels(len(changes), 1, _ROW, margins=Margins(left=0.3, right=0.3, bottom=0.3))
    for [axes], change in zip(grid, changes, strict=True):
        _row(axes, change)
    words = [f"{_title(change)} {number(change.main.value)} {_unit(change)}" for change in changes]
    return to_svg(figure, f"Differences since the baseline with their intervals of 95 %. {'; '.join(words)}.")


def _row(axes: Axes, change: Change) -> None:
    value, (low, high) = change.main.value, change.main.interval
    axes.barh(0.0, high - low, left=low, height=0.5, color=BAND, alpha=0.5, linewidth=0)
    axes.plot([value], [0.0], marker="o", color=PREDICTED, markersize=6, linewidth=0)
    axes.axvline(0.0, color="#4d4d4d", linewidth=0.9)
    # Zero belongs to the axis: whether the interval covers it decides whether there is a change at all.
    span = (0.0, value, low, high)
    room = _ROOM * (max(span) - min(span) or 1.0)
    axes.set_xlim(min(span) - room, max(span) + room)
    axes.set_ylim(-0.5, 0.5)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    was = "" if change.main.before is None else f", {number(change.main.before)} before"
    panel_title(
        axes,
        f"{_title(change)}: {'+' if value > 0 else ''}{number(value)} {_unit(change)} "
        f"({number(low)} to {number(high)}{was})",
    )


def _title(change: Change) -> str:
    place = f" on {', '.join(shortened(name) for name in change.choice.joints)}" if change.choice.joints else ""
    return f"{effect_by_id(change.choice.effect).title}{place}, {change.main.parameter}"


def _unit(change: Change) -> str:
    return "" if change.main.unit == "-" else change.main.unit
