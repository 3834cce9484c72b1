"""The candidates of a diagnosis: their ranking as bars, and the evidence for each."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis import Evidence, RankedEffect
from dynident.effects import get_effect
from dynident.reports.figures.svg import (
    BAND,
    GOOD,
    MUTED,
    PREDICTED,
    RESIDUAL,
    Margins,
    make_panels,
    set_panel_title,
    shorten_name,
    to_svg,
)
from dynident.reports.number_format import format_percent
from dynident.robot import Robot

_EVIDENCE_HEIGHT, _LABEL_HEIGHT = 2.1, 0.44
_EVIDENCE_COLUMNS = 2


def draw_evidence(panel_data: Sequence[Evidence], robot: Robot) -> Markup:
    """Draw the evidence for effects, one panel for each effect and joint.

    Parameters
    ----------
    panel_data : sequence of Evidence
        At least one.
    robot : Robot
        The robot that the model is of.

    Returns
    -------
    Markup
        An inline SVG.
    """
    columns = min(_EVIDENCE_COLUMNS, len(panel_data))
    rows = -(-len(panel_data) // columns)
    figure, grid = make_panels(rows, columns, _EVIDENCE_HEIGHT + (0.25 if rows > 1 else 0.0), below=_LABEL_HEIGHT)
    all_axes = list(chain.from_iterable(grid))
    for axes, evidence in zip(all_axes, panel_data, strict=False):
        _draw_evidence_panel(
            axes, evidence, robot.tree.joints[robot.tree.joint_names.index(evidence.joint)].effort_unit
        )
    # The last row may have fewer panels than columns.
    for axes in all_axes[len(panel_data) :]:
        axes.set_axis_off()
    grid[0][0].legend(fontsize=8, frameon=False, loc="best")
    words = [
        f"{get_effect(panel.effect).title} on {panel.joint}: explains {format_percent(panel.error_drop, 2)} of the "
        "held-out error"
        for panel in panel_data
    ]
    return to_svg(
        figure, f"Mean residual over what each effect depends on, and the fitted effect over it. {'; '.join(words)}."
    )


def _draw_evidence_panel(axes: Axes, evidence: Evidence, effort: str) -> None:
    axes.fill_between(
        evidence.x,
        evidence.residual - evidence.spread,
        evidence.residual + evidence.spread,
        color=BAND,
        alpha=0.3,
        linewidth=0,
        label="its spread",
    )
    axes.plot(
        evidence.x, evidence.residual, color=RESIDUAL, marker=".", markersize=4, linewidth=0, label="mean residual"
    )
    axes.plot(evidence.x, evidence.fitted, color=PREDICTED, linewidth=1.4, label="fitted effect")
    axes.axhline(0, color="#777777", linewidth=0.6)
    axes.set_xlabel(f"{evidence.variable} ({evidence.unit})", fontsize=8)
    title = get_effect(evidence.effect).title
    set_panel_title(
        axes, f"{shorten_name(evidence.joint)} ({effort}), {title}: explains {format_percent(evidence.error_drop, 2)}"
    )


def draw_candidates(candidates: Sequence[RankedEffect]) -> Markup:
    """Draw how much each candidate lowers the error on held-out blocks.

    Parameters
    ----------
    candidates : sequence of RankedEffect
        Best first; at least one.

    Returns
    -------
    Markup
        An inline SVG.
    """
    figure, grid = make_panels(1, 1, 0.3 * len(candidates) + 0.35, margins=Margins(left=2.65))
    axes = grid[0][0]
    # The best candidate stands at the top, where the vertical axis is largest.
    places = np.arange(len(candidates))[::-1]
    # A candidate that makes the error larger has no bar.
    drops = [100 * max(candidate.error_drop, 0.0) for candidate in candidates]
    colours = [GOOD if candidate.significant else MUTED for candidate in candidates]
    axes.barh(places, drops, color=colours, height=0.62)
    for place, drop, candidate in zip(places, drops, candidates, strict=True):
        mark = "✓ " if candidate.significant else ""
        axes.annotate(
            f"{mark}{format_percent(max(candidate.error_drop, 0.0), 2)}",
            (drop, place),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axes.set_yticks(places, [f"{candidate.rank}. {get_effect(candidate.effect).title}" for candidate in candidates])
    axes.set_ylim(-0.6, len(candidates) - 0.4)
    axes.set_xlim(0, max(1.12 * max(drops), 1.0))
    set_panel_title(axes, "drop of the held-out error on its own joints (%); green and ✓: significant")
    axes.grid(False, axis="y")
    significant = [candidate for candidate in candidates if candidate.significant]
    texts = [
        f"{get_effect(candidate.effect).title} {format_percent(candidate.error_drop)}" for candidate in significant
    ]
    return to_svg(figure, f"Drop of the held-out error by candidate effect. Significant: {'; '.join(texts) or 'none'}.")
