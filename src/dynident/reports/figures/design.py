"""Figures of a designed trajectory (joints within their limits, path of the tool) and of a campaign of several."""

from __future__ import annotations

from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from numpy.typing import NDArray

from dynident.advice.campaign import CampaignState
from dynident.advice.campaign_request import MEASURES
from dynident.array_types import FloatArray
from dynident.excitation import Design
from dynident.number_format import choose_time_unit
from dynident.presentation.labels import get_effect_title
from dynident.reports.figures.signals_over_time import find_extremes
from dynident.reports.figures.svg import (
    FLOOR,
    PREDICTED,
    RESIDUAL,
    Margins,
    get_line_style,
    make_panels,
    set_panel_title,
    shorten_name,
    to_svg,
)
from dynident.robot import Robot
from dynident.robot.forward_kinematics import tool_path

_POINTS = 300
_PATH_POINTS = 3000
_LIMIT: dict[str, Any] = {"color": "#4d4d4d", "linewidth": 0.7, "linestyle": (0, (4, 3)), "zorder": 1}


def draw_design(design: Design, robot: Robot) -> Markup:
    """Draw a designed trajectory.

    The upper row has positions, velocities and accelerations as shares of their limits, with the exciting part on
    white. The lower row shows the exciting part alone: velocity over position, and the path of the tool from two sides.

    Parameters
    ----------
    design : Design
        The designed experiment.
    robot : Robot
        The robot that is to move.

    Returns
    -------
    Markup
        An inline SVG.
    """
    figure, grid = make_panels(2, 3, 2.4, margins=Margins(top=0.1, bottom=0.75), gap=0.5)
    position, velocity, acceleration = _compute_limit_shares(design)
    for axes, values, name in zip(
        grid[0], (position, velocity, acceleration), ("position", "velocity", "acceleration"), strict=True
    ):
        _draw_over_time(axes, design, values)
        set_panel_title(axes, f"{name}, share of limit, over time (s)")
    drawn_rows = _select_rows(_find_exciting_rows(design))
    _draw_velocity_over_position(
        grid[1][0], _insert_gaps(position[drawn_rows], drawn_rows), _insert_gaps(velocity[drawn_rows], drawn_rows)
    )
    _draw_tool_path(grid[1][1], grid[1][2], _insert_gaps(tool_path(robot, design.q[drawn_rows]), drawn_rows))
    legend = figure.legend(
        grid[0][0].get_lines()[: len(design.joint_names)],
        [shorten_name(name) for name in design.joint_names],
        loc="lower left",
        ncols=min(7, max(1, 110 // max(len(shorten_name(name)) + 6 for name in design.joint_names))),
        fontsize=8,
        frameon=False,
        borderaxespad=0.1,
    )
    for text in legend.get_texts():
        # A "$" in a joint's name is not the beginning of a formula.
        text.set_parse_math(False)
    return to_svg(
        figure,
        f"Positions, velocities and accelerations of {', '.join(design.joint_names)} over {design.duration:.0f} s as "
        f"shares of their limits; the exciting part lies between {design.exciting[0]:.1f} and "
        f"{design.exciting[1]:.1f} s. Below: velocity over position of every joint, and the path of the tool seen from "
        "above and from the side.",
    )


def _compute_limit_shares(design: Design) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return q, q̇ and q̈ (N, n) as shares of the limits of the design: ±1 touches a limit; NaN of legs that stand."""
    bound = {(margin.joint, margin.limit): margin.bound for margin in design.margins}
    low, high, velocity, acceleration = (
        np.array([bound.get((name, limit), np.nan) for name in design.joint_names])
        for limit in ("position_min", "position_max", "velocity", "acceleration")
    )
    # Position limits need not be symmetric: the share is counted from the middle of the range.
    middle, half = (low + high) / 2, (high - low) / 2
    return (design.q - middle) / half, design.dq / velocity, design.ddq / acceleration


def _find_exciting_rows(design: Design) -> NDArray[np.bool_]:
    """Return which samples (N,) belong to the exciting part, or to a test motion of a set."""
    if design.runs:
        return design.segments > 0
    first, last = design.exciting
    inside: NDArray[np.bool_] = (design.t >= first) & (design.t <= last)
    return inside


def _select_rows(inside: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the indices of the samples to draw, spread evenly over the exciting part."""
    # These curves are drawn over position, not over time: every so many-th sample will do.
    every = max(1, int(inside.sum()) // _PATH_POINTS)
    return np.flatnonzero(inside)[::every]


def _insert_gaps(values: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
    """Return values (m, c) with a row of NaN wherever samples were left out between two of them."""
    gaps = np.diff(rows)
    ends = 1 + np.flatnonzero(gaps > 1.5 * np.median(gaps))
    with_gaps: FloatArray = np.insert(values, ends, np.nan, axis=0)
    return with_gaps


def _draw_over_time(axes: Axes, design: Design, values: FloatArray) -> None:
    for joint, name in enumerate(design.joint_names):
        rows = find_extremes(np.ascontiguousarray(values[:, joint]), _POINTS // 2)
        axes.plot(design.t[rows], values[rows, joint], linewidth=1.0, label=name, **get_line_style(joint))
    inside = _find_exciting_rows(design)
    # The True at both ends makes edges come in pairs: the start and the end of every part that does not excite.
    edges = np.flatnonzero(np.diff(np.concatenate([[True], inside, [True]]).astype(int)))
    for start, end in zip(edges[::2], edges[1::2], strict=True):
        axes.axvspan(
            float(design.t[start]), float(design.t[min(end, len(design.t) - 1)]), color="#f0f0f0", zorder=0, linewidth=0
        )
    for limit in (-1.0, 1.0):
        axes.axhline(limit, **_LIMIT)
    axes.set_xlim(float(design.t[0]), float(design.t[-1]))
    axes.set_ylim(-1.1, 1.1)


def _draw_velocity_over_position(axes: Axes, position: FloatArray, velocity: FloatArray) -> None:
    """Draw velocity over position: where no curve passes, friction and gravity are only extrapolated."""
    for joint in range(position.shape[1]):
        axes.plot(position[:, joint], velocity[:, joint], linewidth=0.6, alpha=0.8, **get_line_style(joint))
    axes.plot([-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1], **_LIMIT)
    axes.set_xlim(-1.1, 1.1)
    axes.set_ylim(-1.1, 1.1)
    axes.set_xlabel("position (share of limit)", fontsize=8)
    set_panel_title(axes, "velocity over position")


def _draw_tool_path(from_above: Axes, from_side: Axes, path: FloatArray) -> None:
    """Draw the path (m, 3) of the last joint's origin in the base frame."""
    for axes, across, title, label in ((from_above, 1, "tool from above (m)", "x, upward y"),
                                       (from_side, 2, "tool from the side (m)", "x, upward z")):  # fmt: skip
        axes.plot(path[:, 0], path[:, across], linewidth=0.7, **get_line_style(0))
        axes.plot(0.0, 0.0, "+", color="#4d4d4d", markersize=7)
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel(label, fontsize=8)
        set_panel_title(axes, title)


def draw_campaign(state: CampaignState) -> Markup:
    """Draw the worst error over robot time: promised before each run, reached after it, and the goal.

    Parameters
    ----------
    state : CampaignState
        A campaign with at least one run.

    Returns
    -------
    Markup
        An inline SVG.
    """
    figure, grid = make_panels(1, 1, 3.2, margins=Margins(left=0.8, right=0.3))
    axes = grid[0][0]
    seconds = np.cumsum([run.seconds for run in state.runs])
    unit, scale = choose_time_unit(float(seconds[-1]))
    elapsed = seconds / scale
    reached = 100 * np.array([run.errors.max() for run in state.runs])
    axes.plot(elapsed, reached, color=RESIDUAL, marker="o", linewidth=1.6, label="reached")
    promises = [
        (m, 100 * run.promised.max()) for m, run in zip(elapsed, state.runs, strict=True) if run.promised is not None
    ]
    if promises:
        times, errors = zip(*promises, strict=True)
        axes.plot(times, errors, color=PREDICTED, marker="s", linestyle="", fillstyle="none", label="promised")
    goal = 100 * state.request.largest_error
    axes.axhline(goal, color=FLOOR, linewidth=1.2, linestyle=(0, (4, 3)), label="goal")
    for time, error, run in zip(elapsed, reached, state.runs, strict=True):
        # Of a load that is not mounted yet, or an effect that would have shown at no size, there is no error to draw.
        if run.is_changed and np.isfinite(error):
            words = ", ".join(dict.fromkeys(get_effect_title(choice.effect) for choice in run.added))
            words = f"with {words}" if words else "no effect added"
            # Words beside the last points would leave the figure.
            side, offset = ("left", 6) if time < 0.6 * elapsed[-1] else ("right", -6)
            axes.annotate(words, (time, error), (offset, 8), textcoords="offset points", fontsize=8, ha=side)
    # An effect that is found has no smallest size left.
    axes.set_yscale("linear" if state.request.goal == "effects" else "log")
    # Powers of ten would have to be read twice.
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_formatter("{x:g}")
    axes.tick_params(which="minor", labelsize=8, color="#999999")
    axes.set_xlim(0, 1.08 * max(float(elapsed[-1]), 1e-3))
    axes.set_xlabel(f"robot time ({unit})", fontsize=8.5)
    axes.legend(fontsize=8, frameon=False)
    measure = MEASURES[state.request.goal][0]
    values = ", ".join(f"{value:.3g} %" if np.isfinite(value) else "none" for value in reached)
    set_panel_title(axes, f"{measure} (%)")
    return to_svg(
        figure,
        f"{measure} after each of {len(state.runs)} runs: {values}; the goal is {goal:.3g} %.",
    )
