"""Measured against predicted torque, and what is left, joint by joint over time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dynident.diagnosis import Comparison
from dynident.reports.figures.decimation import TimeAxis, thinned, time_axis
from dynident.reports.figures.svg import (
    BAND,
    MEASURED,
    PREDICTED,
    RESIDUAL,
    AxesGrid,
    Margins,
    panel_title,
    panels,
    to_svg,
)
from dynident.reports.numbers import percent

_POINTS = 700
_BAND_POINTS = 300
_ROW = 1.6
JOINTS_A_FIGURE = 8


def torque_figure(comparison: Comparison, joints: Sequence[int], name: str) -> Markup:
    """Torque and residual of some joints of one recording."""
    figure, grid = panels(len(joints), 2, _ROW, widths=(3, 2), margins=Margins(top=0.25))
    axis = time_axis(comparison)
    for row, joint in enumerate(joints):
        _torque(grid[row, 0], comparison, axis, joint)
        _residual(grid[row, 1], comparison, axis, joint)
    for axes in grid[-1]:
        axes.set_xlabel(axis.label, fontsize=8)
    _legend(figure, grid)
    return to_svg(figure, _described(comparison, joints, name))


def _torque(axes: Axes, comparison: Comparison, axis: TimeAxis, joint: int) -> None:
    t, measured = thinned(axis, comparison.measured[:, joint], _POINTS)
    axes.plot(t, measured, color=MEASURED, linewidth=1.0, label="measured")
    t, predicted = thinned(axis, comparison.predicted[:, joint], _POINTS)
    axes.plot(t, predicted, color=PREDICTED, linewidth=0.9, label="predicted", dashes=(5, 1.2))
    panel_title(axes, f"{comparison.joint_names[joint]}, torque ({comparison.units[joint]})")
    _whole_time(axes, axis)


def _residual(axes: Axes, comparison: Comparison, axis: TimeAxis, joint: int) -> None:
    t, band = thinned(axis, comparison.band[:, joint], _BAND_POINTS)
    axes.fill_between(t, -band, band, color=BAND, alpha=0.35, linewidth=0, label="95 % band of the model")
    t, rest = thinned(axis, comparison.residual[:, joint], _POINTS)
    axes.plot(t, rest, color=RESIDUAL, linewidth=0.7, label="residual")
    axes.axhline(0, color="#777777", linewidth=0.6)
    largest = 1.08 * max(float(np.abs(comparison.residual[:, joint]).max(initial=0)), float(np.nanmax(band)), 1e-9)
    axes.set_ylim(-largest, largest)
    panel_title(axes, f"residual: measured minus predicted ({comparison.units[joint]})")
    _whole_time(axes, axis)


def _whole_time(axes: Axes, axis: TimeAxis) -> None:
    room = 0.01 * float(axis.t[-1] - axis.t[0])
    axes.set_xlim(float(axis.t[0]) - room, float(axis.t[-1]) + room)


def _legend(figure: Figure, grid: AxesGrid) -> None:
    handles, labels = [], []
    for axes in grid[0]:
        more, texts = axes.get_legend_handles_labels()
        handles += more
        labels += texts
    figure.legend(
        handles, labels, loc="upper right", ncols=4, borderpad=0, borderaxespad=0.1, fontsize=8, frameon=False
    )


def _described(comparison: Comparison, joints: Sequence[int], name: str) -> str:
    rms, relative = comparison.errors.rms, comparison.errors.relative
    parts = [
        f"{comparison.joint_names[j]}: residual {rms[j]:.3g} {comparison.units[j]} rms, {percent(float(relative[j]))}"
        for j in joints
    ]
    return f"Measured and predicted torque of {name} over time, and the residual with its band. {'; '.join(parts)}."
