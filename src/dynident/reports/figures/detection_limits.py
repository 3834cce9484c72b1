"""Detection limits of a diagnosis as a map of effects and joints."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.colors import ListedColormap

from dynident.diagnosis.result import DetectionLimit
from dynident.reports.figures.svg import Margins, make_panels, set_panel_title, shorten_name, to_svg
from dynident.reports.labels import get_effect_title
from dynident.reports.result_rows import format_share
from dynident.robot import Robot

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
        f"Map of detection limits, effects by joints. {seen} of {len(limits)} would have shown in their usual size.",
    )
