"""By how much the friction of each joint differs between two days, with its interval."""

from __future__ import annotations

from collections.abc import Sequence

from markupsafe import Markup

from dynident.diagnosis import FrictionDifference
from dynident.reports.figures.svg import BAND, MEASURED, PREDICTED, Margins, panel_title, panels, shortened, to_svg
from dynident.reports.numbers import number

_ROW, _HEAD = 0.26, 0.35


def friction_figure(friction: Sequence[FrictionDifference]) -> Markup | None:
    """A row a joint: the difference in per cent of what its friction was, and where it lies by 95 %.

    In colour where that is on one side of zero. None where no joint had friction.
    """
    drawn = [one for one in friction if one.before > 0.0]
    if not drawn:
        return None
    margins = Margins(left=2.2, right=0.3, bottom=0.5)
    figure, grid = panels(1, 1, _HEAD + _ROW * len(drawn), margins=margins)
    axes = grid[0][0]
    for row, one in enumerate(drawn):
        value, low, high = (100.0 * each / one.before for each in (one.value, *one.interval))
        colour = MEASURED if low <= 0.0 <= high else PREDICTED
        axes.barh(row, high - low, left=low, height=0.5, color=BAND, alpha=0.5, linewidth=0)
        axes.plot([value], [row], marker="o", color=colour, markersize=5, linewidth=0)
    axes.axvline(0.0, color="#4d4d4d", linewidth=0.9)
    axes.set_ylim(len(drawn) - 0.5, -0.5)
    axes.set_yticks(range(len(drawn)))
    axes.set_yticklabels([shortened(one.joint) for one in drawn], parse_math=False)
    axes.use_sticky_edges = False
    axes.set_xlabel("difference (% of what it was)", fontsize=8)
    panel_title(axes, "Friction of each joint since the baseline, at its mean speed")
    words = [f"{one.joint} {number(100.0 * one.value / one.before)} %" for one in drawn]
    return to_svg(figure, f"Friction since the baseline with intervals of 95 %. {'; '.join(words)}.")
