"""Figures of the ladder of models (error of each, in total and by joint), and of the drift of a simulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.array_types import FloatArray
from dynident.identification import Identification
from dynident.number_format import format_percent
from dynident.reports.figures.svg import (
    FIT,
    FLOOR,
    HELD_OUT,
    STEP_COLOURS,
    Margins,
    get_line_style,
    make_panels,
    set_panel_title,
    shorten_name,
    to_svg,
)
from dynident.validation import Drift

_NEAR_THE_AXIS = 0.12


def draw_models(models: Sequence[Identification], floor: FloatArray | None = None) -> Markup:
    """Draw the errors of a ladder of models where joints move, held-out ones where every model has them.

    Parameters
    ----------
    models : sequence of Identification
        At least one, in the order of the ladder.
    floor : (n,) array, optional
        Relative error that sensor noise alone leaves.

    Returns
    -------
    Markup
        An inline SVG.
    """
    held_out_errors = [model.held_out_judged for model in models if model.held_out_judged is not None]
    held_out = held_out_errors if len(held_out_errors) == len(models) else None
    return draw_ladder(
        [model.fit_judged.relative_total for model in models],
        [item.relative_total for item in held_out] if held_out else None,
        [item.relative for item in held_out or [model.fit_judged for model in models]],
        floor,
        models[-1].model.robot.joint_names,
    )


def draw_ladder(
    fits: Sequence[float],
    held_out: Sequence[float] | None,
    per_joint: Sequence[FloatArray],
    floor: FloatArray | None,
    joint_names: Sequence[str],
) -> Markup:
    """Draw the relative errors of every model of a ladder.

    Parameters
    ----------
    fits : sequence of float
        Total relative error of each model in the fit.
    held_out : sequence of float or None
        The same on held-out data; None where there are none.
    per_joint : sequence of (n,) arrays
        Relative errors of the joints, one array a model; held out where there is such data.
    floor : (n,) array or None
        Relative error that sensor noise alone leaves, where it is known.
    joint_names : sequence of str
        Names of the n joints, in the robot's order.

    Returns
    -------
    Markup
        An inline SVG.
    """
    # The names of the joints stand between the two panels, and take room by their lengths.
    gap = max(0.6, 0.065 * max(len(shorten_name(name)) for name in joint_names) + 0.15)
    figure, grid = make_panels(1, 2, max(2.4, 0.36 * len(joint_names) + 0.7), widths=(2, 3), gap=gap)
    left, right = grid[0]
    _draw_totals(left, fits, held_out)
    _draw_joints(right, per_joint, floor, joint_names, "fit" if held_out is None else "held out")
    totals = held_out if held_out is not None else fits
    kind = "held-out" if held_out is not None else "fit"
    return to_svg(
        figure,
        f"Relative {kind} error of each model of the ladder, in total and per joint: "
        f"{', '.join(format_percent(value) for value in totals)}.",
    )


def _draw_totals(axes: Axes, fits: Sequence[float], held_out: Sequence[float] | None) -> None:
    steps = np.arange(len(fits))
    lines = [("fit", fits, FIT, "o")]
    if held_out is not None:
        lines.append(("held out", held_out, HELD_OUT, "s"))
    for name, values, colour, marker in lines:
        axes.plot(steps, 100 * np.asarray(values), color=colour, marker=marker, linewidth=1.6, label=name)
    scaled = 100 * np.array([values for _, values, _, _ in lines])
    top = 1.2 * float(scaled.max())
    for step in steps:
        # The larger of the two has its number above it, the smaller one below, or beside it where the axis is near.
        for rank, value in enumerate(sorted(scaled[:, step])):
            shift, side = (0, 8), "center"
            if rank == 0 and len(lines) > 1:
                shift, side = ((0, -13), "center") if value > _NEAR_THE_AXIS * top else ((7, -4), "left")
            axes.annotate(f"{value:.3g}", (step, value), shift, textcoords="offset points", ha=side, fontsize=8)
    axes.set_xticks(steps, [f"model {k + 1}" for k in steps])
    axes.set_xlim(-0.4, len(fits) - 0.6)
    axes.set_ylim(0, top)
    set_panel_title(axes, "relative error, all joints (%)")
    axes.legend(fontsize=8, frameon=False, loc="lower left")


def _draw_joints(
    axes: Axes, per_joint: Sequence[FloatArray], floor: FloatArray | None, joint_names: Sequence[str], kind: str
) -> None:
    places = np.arange(len(joint_names))[::-1]
    values = 100 * np.array(per_joint)
    # A grey line joins the errors of one joint.
    axes.hlines(places, values.min(axis=0), values.max(axis=0), color="#cccccc", linewidth=2.5, zorder=1)
    for k, value in enumerate(values):
        last = k == len(values) - 1
        colour = HELD_OUT if last else STEP_COLOURS[k % 4]
        axes.scatter(value, places, s=42 if last else 30, color=colour, zorder=3, label=f"model {k + 1}")
    if floor is not None:
        axes.scatter(100 * floor, places, s=90, marker="|", color=FLOOR, linewidths=2.2, zorder=4, label="noise floor")
    axes.set_yticks(places, [shorten_name(name) for name in joint_names], parse_math=False)
    axes.set_ylim(-0.6, len(joint_names) - 0.4)
    axes.set_xlim(left=0)
    axes.set_xlabel("relative error (%)", fontsize=8)
    set_panel_title(axes, f"relative error per joint (%), {kind}")
    if len(values) > 1 or floor is not None:
        # With a single model, the legend's only entry would look like another joint.
        axes.legend(fontsize=8, frameon=False, loc="best")


def draw_drift(drift: Drift, prismatic: Sequence[bool]) -> Markup:
    """Draw how far a simulation without a controller is off after each time, by joint.

    Parameters
    ----------
    drift : Drift
        The drift.
    prismatic : sequence of bool
        Which joints are prismatic: theirs is in mm, in a panel of its own.

    Returns
    -------
    Markup
        An inline SVG; a line ends where the simulation diverged.
    """
    kinds = [(linear, unit) for linear, unit in ((False, "mrad"), (True, "mm")) if linear in prismatic]
    figure, grid = make_panels(1, len(kinds), 2.6, margins=Margins(right=1.7))
    for axes, (linear, unit) in zip(grid[0], kinds, strict=True):
        for j, name in enumerate(drift.joint_names):
            if bool(prismatic[j]) is linear:
                distance = 1e3 * np.where(np.isfinite(drift.distance[:, j]), drift.distance[:, j], np.nan)
                label, style = shorten_name(name), get_line_style(j)
                axes.plot(drift.after, distance, marker="o", markersize=4, linewidth=1.4, label=label, **style)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.set_xticks(drift.after, [f"{after:g} s" for after in drift.after])
        axes.set_xticks([], minor=True)
        set_panel_title(axes, f"rms distance from the recorded position ({unit})")
        axes.set_xlabel("after", fontsize=8)
    handles = [handle for axes in grid[0] for handle in axes.get_legend_handles_labels()[0]]
    grid[0][-1].legend(handles=handles, fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1.01, 1.0))
    return to_svg(figure, f"Drift of a simulation without a controller. {drift.describe()}")
