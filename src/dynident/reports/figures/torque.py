"""Measured and predicted torque, and the residual, joint by joint over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dynident.array_types import BoolArray
from dynident.diagnosis import Comparison
from dynident.recordings.phases import Phase
from dynident.reports.figures.decimation import TimeAxis, build_time_axis, thin_series, thin_series_together
from dynident.reports.figures.svg import (
    AT_REST,
    BAND,
    MEASURED,
    PREDICTED,
    RESIDUAL,
    STANDING,
    AxesGrid,
    Margins,
    make_panels,
    set_panel_title,
    to_svg,
)
from dynident.reports.number_format import format_percent

_POINTS = 700
_BAND_POINTS = 300
_PANEL_HEIGHT = 1.6
# Halts of a joint that are nearer than this share of the axis are drawn as one: paper does not separate them.
_MIN_SEPARATION = 0.002
_STANDSTILL_LABELS = ("stands", "what friction may hold at rest")
JOINTS_PER_FIGURE = 8


def draw_torque(comparison: Comparison, joints: Sequence[int], name: str) -> Markup:
    """Draw torque and residual of some joints of one recording.

    Parameters
    ----------
    comparison : Comparison
        Measured and predicted torque of one recording.
    joints : sequence of int
        Indices of the joints to draw.
    name : str
        Name of the recording.

    Returns
    -------
    Markup
        An inline SVG.
    """
    figure, grid = make_panels(len(joints), 2, _PANEL_HEIGHT, widths=(3, 2), margins=Margins(top=0.25))
    axis = build_time_axis(comparison)
    for row, joint in enumerate(joints):
        _draw_torque_panel(grid[row][0], comparison, axis, joint)
        _draw_residual_panel(grid[row][1], comparison, axis, joint)
    for axes in grid[-1]:
        axes.set_xlabel(axis.label, fontsize=8)
    _draw_legend(figure, grid, comparison, joints)
    return to_svg(figure, _describe_figure(comparison, joints, name))


def _draw_torque_panel(axes: Axes, comparison: Comparison, axis: TimeAxis, joint: int) -> None:
    standing = comparison.phase[:, joint] == Phase.STANDING
    _shade_standstills(axes, axis, standing)
    rest = axis.restrict(standing)
    t, lower, upper = thin_series_together(rest, _BAND_POINTS, comparison.lower[:, joint], comparison.upper[:, joint])
    # The edges are drawn, too, since a standstill may be narrower than the smallest area that is visible.
    axes.fill_between(t, lower, upper, color=AT_REST, alpha=0.6, linewidth=0.6, label="what friction may hold at rest")
    recorded = comparison.has_torque[:, joint]
    t, measured = thin_series(axis.restrict(recorded), comparison.measured[:, joint], _POINTS)
    axes.plot(t, measured, color=MEASURED, linewidth=1.0, label="measured")
    # At rest the sign of friction is unknown, so the band is the prediction there.
    t, predicted = thin_series(axis.restrict(~standing), comparison.predicted[:, joint], _POINTS)
    axes.plot(t, predicted, color=PREDICTED, linewidth=0.9, label="predicted", dashes=(5, 1.2))
    title = "torque" if recorded.any() else "torque, which was not recorded"
    set_panel_title(axes, f"{comparison.joint_names[joint]}, {title} ({comparison.units[joint]})")
    _set_time_range(axes, axis)


def _draw_residual_panel(axes: Axes, comparison: Comparison, axis: TimeAxis, joint: int) -> None:
    _shade_standstills(axes, axis, comparison.phase[:, joint] == Phase.STANDING)
    t, band = thin_series(axis, comparison.band[:, joint], _BAND_POINTS)
    axes.fill_between(t, -band, band, color=BAND, alpha=0.35, linewidth=0, label="95 % band of the model")
    t, rest = thin_series(axis, comparison.residual[:, joint], _POINTS)
    axes.plot(t, rest, color=RESIDUAL, linewidth=0.7, label="residual")
    axes.axhline(0, color="#777777", linewidth=0.6)
    # The band counts as well as the residual: a model that knows little must not look exact.
    largest = 1.08 * max(float(np.abs(comparison.residual[:, joint]).max(initial=0)), float(np.nanmax(band)), 1e-9)
    axes.set_ylim(-largest, largest)
    set_panel_title(axes, f"residual: measured minus predicted ({comparison.units[joint]})")
    _set_time_range(axes, axis)


def _shade_standstills(axes: Axes, axis: TimeAxis, standing: BoolArray) -> None:
    """Shade the times at which the joint stands; halts too close for paper to separate become one."""
    least = _MIN_SEPARATION * float(axis.t[-1] - axis.t[0])
    spans: list[list[float]] = []
    for part in axis.restrict(standing).stretches:
        first, last = float(axis.t[part.start]), float(axis.t[part.stop - 1])
        if spans and first - spans[-1][1] < least:
            spans[-1][1] = last
        else:
            spans.append([first, last])
    across = [(first, last - first) for first, last in spans]
    ground = axes.get_xaxis_transform()
    axes.broken_barh(across, (0, 1), transform=ground, facecolors=STANDING, linewidth=0, zorder=0, label="stands")


def _set_time_range(axes: Axes, axis: TimeAxis) -> None:
    room = 0.01 * float(axis.t[-1] - axis.t[0])
    axes.set_xlim(float(axis.t[0]) - room, float(axis.t[-1]) + room)


def _draw_legend(figure: Figure, grid: AxesGrid, comparison: Comparison, joints: Sequence[int]) -> None:
    handles: list[Artist] = []
    labels: list[str] = []
    rests = bool((comparison.phase[:, list(joints)] == Phase.STANDING).any())
    for axes in grid[0]:
        for handle, text in zip(*axes.get_legend_handles_labels(), strict=True):
            # One legend for all joints: what stands for rest is left out where no joint ever rests.
            if text not in labels and (rests or text not in _STANDSTILL_LABELS):
                handles.append(handle)
                labels.append(text)
    figure.legend(
        handles,
        labels,
        loc="upper right",
        ncols=len(labels),
        columnspacing=1.4,
        borderpad=0,
        borderaxespad=0.1,
        fontsize=8,
        frameon=False,
    )


def _describe_figure(comparison: Comparison, joints: Sequence[int], name: str) -> str:
    rms, relative = comparison.errors.rms, comparison.errors.relative
    stands = (comparison.phase == Phase.STANDING).mean(axis=0)
    parts = [
        f"{comparison.joint_names[j]}: residual {rms[j]:.3g} {comparison.units[j]} rms, "
        f"{format_percent(float(relative[j]))}"
        + (f", standing in {format_percent(float(stands[j]), 2)} of the rows" if stands[j] > 0 else "")
        for j in joints
    ]
    return f"Measured and predicted torque of {name} over time, and the residual with its band. {'; '.join(parts)}."
