"""The ranking of a diagnosis's candidates as bars."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from dynident.diagnosis import RankedEffect
from dynident.effects import get_effect
from dynident.reports.figures.svg import GOOD, MUTED, Margins, make_panels, set_panel_title, to_svg
from dynident.reports.numbers import format_percent


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
