"""The difference of each joint's friction between two sets of recordings, with its interval."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from dynident.diagnosis import FrictionDifference
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
from dynident.reports.numbers import format_number

_FRICTION_ROW_HEIGHT, _FRICTION_HEAD_HEIGHT = 0.26, 0.35


def draw_friction_differences(friction: Sequence[FrictionDifference]) -> Markup | None:
    """Draw the difference of each joint's friction in per cent of what it was, with its 95 % interval.

    A difference is in colour where its interval does not cover zero.

    Parameters
    ----------
    friction : sequence of FrictionDifference

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
        colour = MEASURED if low <= 0.0 <= high else PREDICTED
        axes.barh(row, high - low, left=low, height=0.5, color=BAND, alpha=0.5, linewidth=0)
        axes.plot([value], [row], marker="o", color=colour, markersize=5, linewidth=0)
    axes.axvline(0.0, color="#4d4d4d", linewidth=0.9)
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
