"""The difference of each joint's friction between two sets of recordings, with its interval."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from dynident.diagnosis import FrictionDifference
from dynident.reports.figures.svg import BAND, MEASURED, PREDICTED, Margins, panel_title, panels, shortened, to_svg
from dynident.reports.numbers import number

_ROW, _HEAD = 0.26, 0.35


def friction_figure(friction: Sequence[FrictionDifference]) -> Markup | None:
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
    figure, grid = panels(1, 1, _HEAD + _ROW * len(drawn), margins=margins)
    axes = grid[0][0]
    for row, difference in enumerate(drawn):
        value, low, high = (100.0 * end / difference.before for end in (difference.value, *difference.interval))
        colour = MEASURED if low <= 0.0 <= high else PREDICTED
        axes.barh(row, high - low, left=low, height=0.5, color=BAND, alpha=0.5, linewidth=0)
        axes.plot([value], [row], marker="o", color=colour, markersize=5, linewidth=0)
    axes.axvline(0.0, color="#4d4d4d", linewidth=0.9)
    axes.set_ylim(len(drawn) - 0.5, -0.5)
    axes.set_yticks(range(len(drawn)))
    axes.set_yticklabels([shortened(difference.joint) for difference in drawn], parse_math=False)
    # Bars otherwise pin the axis to their own ends, without a margin.
    axes.use_sticky_edges = False
    axes.set_xlabel("difference (% of what it was)", fontsize=8)
    panel_title(axes, "Friction of each joint since the baseline, at its mean speed")
    words = [f"{difference.joint} {number(100.0 * difference.value / difference.before)} %" for difference in drawn]
    return to_svg(figure, f"Friction since the baseline with intervals of 95 %. {'; '.join(words)}.")
