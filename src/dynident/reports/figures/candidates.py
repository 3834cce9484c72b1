"""The ranking of missing effects as bars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from dynident.diagnosis import RankedEffect
from dynident.effects import effect_by_id
from dynident.reports.figures.svg import GOOD, MUTED, Margins, panel_title, panels, to_svg
from dynident.reports.numbers import percent


def candidates_figure(candidates: Sequence[RankedEffect]) -> Markup:
    """How much every family of effects lowers the error on data left out of the fit."""
    figure, grid = panels(1, 1, 0.3 * len(candidates) + 0.35, margins=Margins(left=2.65))
    axes = grid[0][0]
    places = np.arange(len(candidates))[::-1]
    drops = [100 * max(item.error_drop, 0.0) for item in candidates]
    colours = [GOOD if item.significant else MUTED for item in candidates]
    axes.barh(places, drops, color=colours, height=0.62)
    for place, drop, item in zip(places, drops, candidates, strict=True):
        mark = "✓ " if item.significant else ""
        axes.annotate(
            f"{mark}{percent(max(item.error_drop, 0.0), 2)}",
            (drop, place),
            (4, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    axes.set_yticks(places, [f"{item.rank}. {effect_by_id(item.effect).title}" for item in candidates])
    axes.set_ylim(-0.6, len(candidates) - 0.4)
    axes.set_xlim(0, max(1.12 * max(drops), 1.0))
    panel_title(axes, "drop of the held-out error on its own joints (%); green and ✓: significant")
    axes.grid(False, axis="y")
    found = [f"{effect_by_id(c.effect).title} {percent(c.error_drop)}" for c in candidates if c.significant]
    return to_svg(figure, f"Drop of the held-out error by candidate effect. Significant: {'; '.join(found) or 'none'}.")
