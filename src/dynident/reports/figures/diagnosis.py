"""Figures of a diagnosis: ranking of effects, evidence of each, detection limits as a map."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import chain

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap

from dynident.diagnosis import Evidence, RankedEffect
from dynident.diagnosis.diagnosis_result import DetectionLimit
from dynident.effects import get_effect
from dynident.number_format import format_percent
from dynident.presentation.diagnosis_tables import format_share
from dynident.presentation.labels import get_effect_title
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
        "error on blocks left out of the fit"
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
    """Draw how much each candidate lowers the error on blocks left out of the fit.

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
    set_panel_title(axes, "drop of the error on blocks left out of the fit, on the effect's joints (%); ✓: significant")
    axes.grid(False, axis="y")
    significant = [candidate for candidate in candidates if candidate.significant]
    texts = [
        f"{get_effect(candidate.effect).title} {format_percent(candidate.error_drop)}" for candidate in significant
    ]
    named = "; ".join(texts) or "none"
    drop_of = "Drop of the error on blocks left out of the fit, by candidate effect"
    return to_svg(figure, f"{drop_of}. Significant: {named}.")


_ROW_HEIGHT = 0.22
_LEVELS = (0.1, 0.3, 1.0, 3.0)
"""Shares of the usual size between the colours."""
_COLOURS = ("#d9eef7", "#9fd3ea", "#56b4e9", "#f2c9a1", "#d55e00", "#9a9a9a")
"""From what shows easily to what does not show at all; blue where the usual size would have shown."""
_MOST_NUMBERS = 12
"""With more joints, numbers in the cells would be too small to read."""


def draw_detection_limits(limits: Sequence[DetectionLimit], robot: Robot) -> Markup:
    """Draw the detection limits as a map of effects and joints, in shares of the usual size.

    Parameters
    ----------
    limits : sequence of DetectionLimit
        At least one.
    robot : Robot
        The robot that the model is of.

    Returns
    -------
    Markup
        An inline SVG.
    """
    effects = list(dict.fromkeys(limit.effect for limit in limits))
    joints = list(robot.tree.joint_names)
    has_whole = any(not limit.joints for limit in limits)
    places = [*joints, *(["whole robot"] if has_whole else [])]
    shares = np.full((len(effects), len(places)), np.nan)
    for limit in limits:
        column = places.index(limit.joints[0]) if limit.joints else len(places) - 1
        shares[effects.index(limit.effect), column] = limit.share
    figure, grid = make_panels(
        1, 1, _ROW_HEIGHT * len(effects) + 0.35, margins=Margins(left=2.65, bottom=0.85), below=0.0
    )
    axes = grid[0][0]
    levels = np.where(np.isnan(shares), np.nan, np.digitize(shares, _LEVELS).astype(float))
    levels[np.isinf(shares)] = len(_LEVELS) + 1
    axes.pcolormesh(
        np.ma.masked_invalid(levels),
        cmap=ListedColormap(_COLOURS),
        vmin=-0.5,
        vmax=len(_COLOURS) - 0.5,
        edgecolors="white",
        linewidth=1.0,
    )
    if len(places) <= _MOST_NUMBERS:
        for (row, column), share in np.ndenumerate(shares):
            if not np.isnan(share):
                axes.text(column + 0.5, row + 0.5, format_share(share), ha="center", va="center", fontsize=8)
    axes.invert_yaxis()
    axes.set_yticks(np.arange(len(effects)) + 0.5, [get_effect_title(effect) for effect in effects])
    axes.set_xticks(
        np.arange(len(places)) + 0.5, [shorten_name(name) for name in places], rotation=30, ha="right", fontsize=8
    )
    axes.grid(False)
    axes.tick_params(length=0)
    set_panel_title(axes, "detection limit over usual size; blue: the usual size would have shown, grey: no size would")
    seen = sum(limit.share <= 1.0 for limit in limits)
    return to_svg(
        figure,
        f"Map of detection limits, effects by joints. {seen} of {len(limits)} would have shown at their usual size.",
    )
