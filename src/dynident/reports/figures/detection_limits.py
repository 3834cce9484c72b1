"""Detection limits of a diagnosis: a map of effects and joints, and one row of text for each effect."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.colors import ListedColormap

from dynident.diagnosis.result import DetectionLimit
from dynident.reports.figures.svg import Margins, make_panels, set_panel_title, shorten_name, to_svg
from dynident.reports.labels import format_joints, get_effect_title
from dynident.robot import Robot

_ROW_HEIGHT = 0.26
_LEVELS = (0.1, 0.3, 1.0, 3.0)
"""Shares of the usual size between the colours."""
_COLOURS = ("#d9eef7", "#9fd3ea", "#56b4e9", "#f2c9a1", "#d55e00", "#9a9a9a")
"""From what shows easily to what does not show at all; blue where the usual size would have shown."""
_MOST_NUMBERS = 12
"""With more joints, numbers in the cells would be too small to read."""

LIMIT_COLUMNS = ("effect", "would have shown from", "of the usual size", "not in its usual size on")


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


def format_limits(limits: Sequence[DetectionLimit], robot: Robot) -> list[tuple[str, ...]]:
    """Return one row of text for each effect, whatever the number of joints.

    Parameters
    ----------
    limits : sequence of DetectionLimit
        The detection limits.
    robot : Robot
        The robot that the model is of.

    Returns
    -------
    list of tuple of str
        The cells of `LIMIT_COLUMNS`.
    """
    rows: list[tuple[str, ...]] = []
    for effect in dict.fromkeys(limit.effect for limit in limits):
        own = [limit for limit in limits if limit.effect == effect]
        blind = [name for limit in own if limit.share > 1.0 for name in limit.joints or ("",)]
        where = "" if not blind else "the whole robot" if blind == [""] else format_joints(blind, robot.joint_names)
        rows.append((get_effect_title(effect), _format_sizes(own), _format_range([o.share for o in own]), where or "–"))
    return rows


def format_share(share: float) -> str:
    """Return a limit over the usual size as a percentage or a factor; "–" where no size would have shown."""
    if not math.isfinite(share):
        return "–"
    return f"{100.0 * share:.2g} %" if share < 0.995 else f"{share:.2g} x" if share < 10.0 else f"{share:.0f} x"


def _format_range(shares: Sequence[float]) -> str:
    low, high = format_share(min(shares)), format_share(max(shares))
    return low if low == high else f"{low} to {high if math.isfinite(max(shares)) else 'none'}"


def _format_sizes(limits: Sequence[DetectionLimit]) -> str:
    """Return the smallest and the largest limit with their unit; units of joints of other kinds follow each other."""
    texts = []
    for unit in dict.fromkeys(limit.unit for limit in limits):
        sizes = [limit.size for limit in limits if limit.unit == unit and math.isfinite(limit.size)]
        words = "" if unit == "-" else f" {unit}"
        if sizes:
            low, high = f"{min(sizes):.2g}", f"{max(sizes):.2g}"
            texts.append(f"{low}{words}" if low == high else f"{low} to {high}{words}")
    return ", ".join(texts) or "no size"
