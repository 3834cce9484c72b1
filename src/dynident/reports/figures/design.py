"""A designed trajectory over time."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.excitation import Design
from dynident.reports.figures.decimation import extremes
from dynident.reports.figures.svg import Margins, panel_title, panels, shortened, to_svg
from dynident.robot import Robot
from dynident.robot.model import FloatArray

# Okabe and Ito's palette without yellow, which paper does not show.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#4d4d4d")
_STYLES = ("-", "--", ":")
_POINTS = 300


def design_figure(design: Design, robot: Robot) -> Markup:
    """Positions and velocities of all joints; the exciting part is white."""
    figure, grid = panels(1, 2, 2.7, margins=Margins(top=0.1, bottom=0.75))
    kinds = {joint.kind for joint in robot.joints}
    angle = "rad" if kinds == {"revolute"} else "m" if kinds == {"prismatic"} else "rad or m"
    for axes, values, name in ((grid[0, 0], design.q, "position"), (grid[0, 1], design.dq, "velocity")):
        _lines(axes, design, values)
        panel_title(axes, f"{name} ({angle}{'/s' if name == 'velocity' else ''})")
        axes.set_xlabel("time (s)", fontsize=8)
    legend = figure.legend(
        grid[0, 0].get_lines(),
        [shortened(name) for name in design.joint_names],
        loc="lower left",
        ncols=min(7, max(1, 110 // max(len(shortened(name)) + 6 for name in design.joint_names))),
        fontsize=8,
        frameon=False,
        borderaxespad=0.1,
    )
    for text in legend.get_texts():
        text.set_parse_math(False)
    return to_svg(
        figure,
        f"Positions and velocities of {', '.join(design.joint_names)} over {design.duration:.0f} s; the exciting part "
        f"lies between {design.exciting[0]:.1f} and {design.exciting[1]:.1f} s.",
    )


def _lines(axes: Axes, design: Design, values: FloatArray) -> None:
    for joint, name in enumerate(design.joint_names):
        kept = extremes(np.ascontiguousarray(values[:, joint]), _POINTS // 2)
        style = _STYLES[joint // len(_COLOURS) % len(_STYLES)]
        colour = _COLOURS[joint % len(_COLOURS)]
        axes.plot(design.t[kept], values[kept, joint], color=colour, linewidth=1.1, linestyle=style, label=name)
    first, last = design.exciting
    for start, end in ((float(design.t[0]), first), (last, float(design.t[-1]))):
        axes.axvspan(start, end, color="#f0f0f0", zorder=0)
    axes.set_xlim(float(design.t[0]), float(design.t[-1]))
