"""The figure behind a ranked effect: the residual over what the effect depends on, and what the effect explains."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis import Evidence
from dynident.effects import effect_by_id
from dynident.reports.figures.svg import BAND, PREDICTED, RESIDUAL, panel_title, panels, shortened, to_svg
from dynident.reports.numbers import percent
from dynident.robot import Robot

_ROW, _LABELLED = 2.1, 0.44
_ACROSS = 2


def evidence_figure(shown: Sequence[Evidence], robot: Robot) -> Markup:
    """One panel an effect and joint, two in a row; at least one has to be given."""
    columns = min(_ACROSS, len(shown))
    rows = -(-len(shown) // columns)
    figure, grid = panels(rows, columns, _ROW + (0.25 if rows > 1 else 0.0), below=_LABELLED)
    every = list(chain.from_iterable(grid))
    for axes, one in zip(every, shown, strict=False):
        _panel(axes, one, robot.tree.joints[robot.tree.joint_names.index(one.joint)].effort_unit)
    for axes in every[len(shown) :]:
        axes.set_axis_off()
    grid[0][0].legend(fontsize=8, frameon=False, loc="best")
    words = [
        f"{effect_by_id(one.effect).title} on {one.joint} explains {percent(one.explained, 2)} of its squares"
        for one in shown
    ]
    return to_svg(
        figure, f"Mean residual over what each effect depends on, and the fitted effect over it. {'; '.join(words)}."
    )


def _panel(axes: Axes, one: Evidence, effort: str) -> None:
    axes.fill_between(
        one.x,
        one.residual - one.spread,
        one.residual + one.spread,
        color=BAND,
        alpha=0.3,
        linewidth=0,
        label="its spread",
    )
    axes.plot(one.x, one.residual, color=RESIDUAL, marker=".", markersize=4, linewidth=0, label="mean residual")
    axes.plot(one.x, one.fitted, color=PREDICTED, linewidth=1.4, label="what the effect explains")
    axes.axhline(0, color="#777777", linewidth=0.6)
    axes.set_xlabel(f"{one.variable} ({one.unit})", fontsize=8)
    title = effect_by_id(one.effect).title
    panel_title(axes, f"{shortened(one.joint)} ({effort}), {title}: explains {percent(one.explained, 2)}")
