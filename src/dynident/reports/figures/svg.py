"""Draw matplotlib figures as inline SVG: width, margins, colours of the ladder's steps, descriptions."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from threading import Lock
from typing import Literal, TypedDict

import matplotlib as mpl
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.mathtext import MathTextParser

from dynident.text_encoding import replace_control_characters

AxesGrid = list[list[Axes]]
"""Rows of axes."""

# The palette of Okabe and Ito, which colour-blind readers and prints in grey can tell apart.
MEASURED, PREDICTED, RESIDUAL, BAND = "#4d4d4d", "#d55e00", "#0072b2", "#56b4e9"
AT_REST, STANDING = "#f0b27a", "#ececec"
FIT, HELD_OUT, FLOOR, GOOD, MUTED = "#56b4e9", "#d55e00", "#009e73", "#009e73", "#9a9a9a"
# The palette without yellow, which paper does not show, and styles for more joints than it has colours.
_JOINT_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#4d4d4d")
_JOINT_STYLES = ("-", "--", ":")
STEP_COLOURS = ("#9a9a9a", "#56b4e9", "#0072b2", "#e69f00", "#d55e00", "#cc79a7")

WIDTH = 10.6
_TITLE_HEIGHT, _TICKS_HEIGHT = 0.27, 0.24
_LONGEST_NAME = 32
_NO_METADATA = {"Date": None, "Creator": None, "Format": None, "Type": None}
# The setting of matplotlib that keeps text as text is global to the process, so one figure is drawn at a time.
_drawing = Lock()


@dataclass(frozen=True)
class Margins:
    """Margins around the panels of a figure, in inches."""

    left: float = 0.6
    right: float = 0.08
    top: float = 0.1
    bottom: float = 0.5


def make_panels(
    rows: int,
    columns: int,
    height: float,
    *,
    widths: Sequence[float] | None = None,
    margins: Margins | None = None,
    gap: float = 0.55,
    below: float = _TICKS_HEIGHT,
) -> tuple[Figure, AxesGrid]:
    """Make a figure of the page's width with a grid of axes.

    The axes are placed by inches: matplotlib's layout engine takes several times as long as the drawing.

    Parameters
    ----------
    rows, columns : int
        Numbers of rows and columns of the grid.
    height : float
        Height of a row with its titles, in inches.
    widths : sequence of float, optional
        Ratios of the columns' widths; all the same by default.
    margins : Margins, optional
        Margins around the panels; the usual ones by default.
    gap : float
        Room between columns, in inches.
    below : float
        Room for ticks and label below each panel, in inches, where there are several rows.

    Returns
    -------
    figure : Figure
        The figure, to be drawn by `to_svg`.
    grid : list of list of Axes
        Its axes, row by row.
    """
    edges = margins or Margins()
    total = rows * height + edges.top + edges.bottom
    figure = Figure(figsize=(WIDTH, total))
    ratios = np.asarray(widths or [1.0] * columns)
    free = WIDTH - edges.left - edges.right - (columns - 1) * gap
    # What margins and gaps leave of the width is shared out by the ratios.
    spans = free * ratios / ratios.sum()
    starts = edges.left + np.concatenate([[0.0], np.cumsum(spans + gap)[:-1]])
    panel = height - _TITLE_HEIGHT - (below if rows > 1 else 0.0)
    grid: AxesGrid = []
    for row in range(rows):
        low = total - edges.top - row * height - _TITLE_HEIGHT - panel
        grid.append([])
        for column in range(columns):
            box = (starts[column] / WIDTH, low / total, spans[column] / WIDTH, panel / total)
            grid[row].append(figure.add_axes(box))
            _style_axes(grid[row][column])
    return figure, grid


def _style_axes(axes: Axes) -> None:
    """Remove what is not data from a panel, and set its ticks and grid."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.spines[["left", "bottom"]].set_color("#999999")
    axes.tick_params(labelsize=8, color="#999999", length=3)
    axes.grid(True, color="#e6e6e6", linewidth=0.6)
    axes.set_axisbelow(True)


def set_panel_title(axes: Axes, text: str) -> None:
    """Write a title over a panel; names of joints in it are taken literally, not as formulas."""
    # Without a height given, matplotlib looks for ticks above the panel, and lays out every label a second time.
    axes.set_title(text, fontsize=8.5, loc="left", y=1.0, pad=4, color="#333333", parse_math=False)


class LineStyle(TypedDict):
    """Colour and style of a line, as arguments of `Axes.plot`."""

    color: str
    linestyle: str


def get_line_style(joint: int) -> LineStyle:
    """Return colour and style of the line of a joint, by its index."""
    count = len(_JOINT_COLOURS)
    return {"color": _JOINT_COLOURS[joint % count], "linestyle": _JOINT_STYLES[joint // count % len(_JOINT_STYLES)]}


def shorten_name(name: str) -> str:
    """Return a name cut to what fits beside a panel."""
    return name if len(name) <= _LONGEST_NAME else f"{name[: _LONGEST_NAME - 1]}…"


class Drawing(Markup):
    """An <svg> element that knows the matplotlib figure it was drawn from.

    Attributes
    ----------
    figure : matplotlib.figure.Figure
        The figure; the element does not follow changes of it.
    """

    figure: Figure

    def __reduce__(self) -> tuple[type[Markup], tuple[str]]:
        # Jobs hand drawings on to other processes, which need the element alone.
        return (Markup, (str(self),))


def to_svg(figure: Figure, description: str) -> Drawing:
    """Return a figure as an <svg> element.

    Parameters
    ----------
    figure : Figure
        The figure.
    description : str
        What a reader who cannot see the figure is told.

    Returns
    -------
    Drawing
        The element, to be put into a page.
    """
    drawing = Drawing(_to_inline_svg(_render_svg(figure, "none"), description))
    drawing.figure = figure
    return drawing


@lru_cache(256)
def draw_formula(formula: str, size: float = 11.0) -> Markup | None:
    """Draw a LaTeX formula; each is drawn once in a process, since every report has the same ones.

    Parameters
    ----------
    formula : str
        LaTeX without dollar signs.
    size : float
        Size of the font, in points.

    Returns
    -------
    Markup or None
        An inline SVG; None where matplotlib's mathtext does not know the formula.
    """
    font = FontProperties(size=size)
    try:
        with _drawing:
            width, height, depth, *_ = MathTextParser("path").parse(f"${formula}$", dpi=72, prop=font)
    except ValueError:
        return None
    # A point around the formula, since slanted letters reach beyond the box that is measured.
    pad = 1.0
    wide, high = float(width) + 2 * pad, float(height) + float(depth) + 2 * pad
    figure = Figure(figsize=(wide / 72, high / 72))
    figure.patch.set_visible(False)
    figure.text(pad / wide, (float(depth) + pad) / high, f"${formula}$", fontproperties=font)
    return _to_inline_svg(
        _render_svg(figure, "path"), formula, f' class="formula" style="width:{wide:.1f}pt;height:{high:.1f}pt"'
    )


def _render_svg(figure: Figure, text_as: Literal["none", "path"]) -> str:
    file = io.StringIO()
    with _drawing, mpl.rc_context({"svg.fonttype": text_as, "svg.hashsalt": "dynident"}):
        # The salt makes the ids in the file the same each time. Figure.savefig would draw everything twice.
        FigureCanvasSVG(figure).print_svg(file, metadata=_NO_METADATA)  # type: ignore[no-untyped-call]
    return file.getvalue()


def _to_inline_svg(text: str, description: str, attributes: str = "") -> Markup:
    """Return an SVG file as an element with a description, without fixed size, needless decimals and list of fonts."""
    body = text[text.index("<svg") :]
    head, rest = body.split(">", 1)
    box = re.search(r'viewBox="([^"]+)"', head)
    name = escape(description, quote=True)
    opening = (
        f'<svg{attributes} xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="{box[1] if box else "0 0 1 1"}" role="img" aria-label="{name}">'
    )
    rest = re.sub(r"\s*<metadata>.*?</metadata>", "", rest, flags=re.DOTALL)
    # Two decimals of a point are finer than any screen or printer, and halve the size of the file.
    rest = re.sub(r' d="([^"]*)"', lambda match: f' d="{_round_path(match[1])}"', rest)
    rest = re.sub(r"font: ([^;\"]*?px) [^;\"]*", r"font: \1 sans-serif", rest)
    rest = re.sub(r"\n\s*", "\n", rest)
    # Names from a user's file may hold characters that no XML may hold.
    return Markup(replace_control_characters(opening + rest))


def _round_path(path: str) -> str:
    return re.sub(r"(\.\d{2})\d+", r"\1", path).replace(" \n", "").replace("\n", " ")
