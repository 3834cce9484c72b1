"""Matplotlib figures as inline SVG: small, with real text, with a title for those who cannot see them."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from threading import Lock
from typing import Literal

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser

from dynident.encoding import without_control_characters

AxesGrid = list[list[Axes]]
"""Rows of axes."""

# Okabe and Ito's palette: told apart by everybody, and in grey.
MEASURED, PREDICTED, RESIDUAL, BAND = "#4d4d4d", "#d55e00", "#0072b2", "#56b4e9"
AT_REST, STANDING = "#f0b27a", "#ececec"
FIT, HELD_OUT, FLOOR, GOOD, MUTED = "#56b4e9", "#d55e00", "#009e73", "#009e73", "#9a9a9a"
RUNGS = ("#9a9a9a", "#56b4e9", "#0072b2", "#e69f00", "#d55e00", "#cc79a7")

WIDTH = 10.6
_TITLE_HEIGHT, _TICKS_HEIGHT = 0.27, 0.24
_LONGEST_NAME = 32
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}
# The setting of matplotlib under which text stays text is the process's own: one figure is drawn at a time.
_drawing = Lock()


@dataclass(frozen=True)
class Margins:
    """Room in inches around the panels of a figure."""

    left: float = 0.6
    right: float = 0.08
    top: float = 0.1
    bottom: float = 0.5


def panels(
    rows: int,
    columns: int,
    height: float,
    *,
    widths: Sequence[float] | None = None,
    margins: Margins | None = None,
    gap: float = 0.55,
    below: float = _TICKS_HEIGHT,
) -> tuple[Figure, AxesGrid]:
    """A figure over the page's width with a grid of axes: rows `height` inches with their titles, columns `gap` apart.

    Where there are several rows, `below` each panel is what its ticks, and its label if it has one, take.

    Placed by inches rather than by matplotlib's layout engine, which takes several times as long as the drawing.
    """
    room = margins or Margins()
    total = rows * height + room.top + room.bottom
    figure = Figure(figsize=(WIDTH, total))
    ratios = np.asarray(widths or [1.0] * columns)
    free = WIDTH - room.left - room.right - (columns - 1) * gap
    spans = free * ratios / ratios.sum()
    starts = room.left + np.concatenate([[0.0], np.cumsum(spans + gap)[:-1]])
    panel = height - _TITLE_HEIGHT - (below if rows > 1 else 0.0)
    grid: AxesGrid = []
    for row in range(rows):
        low = total - room.top - row * height - _TITLE_HEIGHT - panel
        grid.append([])
        for column in range(columns):
            box = (starts[column] / WIDTH, low / total, spans[column] / WIDTH, panel / total)
            grid[row].append(figure.add_axes(box))
            _plain(grid[row][column])
    return figure, grid


def _plain(axes: Axes) -> None:
    """Take away what is not data."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#999999")
    axes.tick_params(labelsize=8, color="#999999", length=3)
    axes.grid(True, color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)


def panel_title(axes: Axes, text: str) -> None:
    """A title over a panel; whatever a user called a joint is taken literally."""
    axes.set_title(text, fontsize=8.5, loc="left", pad=4, color="#333333", parse_math=False)


def shortened(name: str) -> str:
    """A name that fits beside a panel."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"


def to_svg(figure: Figure, description: str) -> Markup:
    """The figure as an <svg> element; `description` is what a reader who does not see it is told."""
    return _inline(_drawn(figure, "none"), description)


def drawn_formula(formula: str, size: float = 11.0) -> Markup | None:
    """A LaTeX formula as an inline <svg>, or None where matplotlib's mathtext does not know it."""
    font = FontProperties(size=size)
    try:
        with _drawing:
            width, height, depth, *_ = MathTextParser("path").parse(f"${formula}$", dpi=72, prop=font)
    except ValueError:
        return None
    pad = 1.0
    wide, high = float(width) + 2 * pad, float(height) + float(depth) + 2 * pad
    figure = Figure(figsize=(wide / 72, high / 72))
    figure.patch.set_visible(False)
    figure.text(pad / wide, (float(depth) + pad) / high, f"${formula}$", fontproperties=font)
    return _inline(_drawn(figure, "path"), formula, f' class="formula" style="width:{wide:.1f}pt;height:{high:.1f}pt"')


def _drawn(figure: Figure, text_as: Literal["none", "path"]) -> str:
    file = io.StringIO()
    with _drawing, mpl.rc_context({"svg.fonttype": text_as, "svg.hashsalt": "dynident"}):
        # Not savefig, which draws everything twice.
        FigureCanvasSVG(figure).print_svg(file, metadata=_NO_METADATA)  # type: ignore[no-untyped-call]
    return file.getvalue()


def _inline(text: str, description: str, attributes: str = "") -> Markup:
    """Without the file's head, fixed size, needless decimals and the list of fonts; with a description."""
    body = text[text.index("<svg") :]
    head, rest = body.split(">", 1)
    box = re.search(r'viewBox="([^"]+)"', head)
    name = escape(description, quote=True)
    opening = (
        f'<svg{attributes} xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="{box[1] if box else "0 0 1 1"}" role="img" aria-label="{name}">'
    )
    rest = re.sub(r"\s*<metadata>.*?</metadata>", "", rest, flags=re.DOTALL)
    rest = re.sub(r' d="([^"]*)"', lambda found: f' d="{_rounded(found[1])}"', rest)
    rest = re.sub(r"font: ([^;\"]*?px) [^;\"]*", r"font: \1 sans-serif", rest)
    rest = re.sub(r"\n\s*", "\n", rest)
    return Markup(without_control_characters(opening + rest))


def _rounded(path: str) -> str:
    return re.sub(r"(\.\d{2})\d+", r"\1", path).replace(" \n", "").replace("\n", " ")
