"""Figures of the residual over velocity, position and load, and of its spectra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm

from dynident.array_types import FloatArray
from dynident.diagnosis import Comparison, ResidualSpectrum, angle_spectrum, time_spectrum
from dynident.diagnosis.comparison.residual_autocorrelation_and_spectra import HIGHEST_IN_A_METRE, HIGHEST_IN_A_RADIAN
from dynident.errors import DynidentError
from dynident.reports.figures.svg import PREDICTED, RESIDUAL, make_panels, set_panel_title, to_svg

_SPECTRUM_HEIGHT = 1.35
_SPECTRUM_POINTS = 500
_LABELLED_PEAKS = 2


def draw_spectra(comparison: Comparison, joints: range) -> Markup:
    """Draw amplitude spectra of some joints' residual in one recording.

    Parameters
    ----------
    comparison : Comparison
        Measured and predicted torque of one recording.
    joints : range
        Indices of the joints to draw.

    Returns
    -------
    Markup
        An inline SVG; a panel says so where the recording is too short for its spectrum.
    """
    figure, grid = make_panels(len(joints), 2, _SPECTRUM_HEIGHT)
    for row, joint in enumerate(joints):
        residual = comparison.residual[:, joint]
        unit = comparison.units[joint]
        name = comparison.joint_names[joint]
        try:
            _draw_spectrum(grid[row][0], time_spectrum(comparison.t, comparison.segment, residual), 1.0)
        # A recording too short for a spectrum is no reason to have no report.
        except DynidentError as error:
            _draw_reason(grid[row][0], error.title)
        revolute = unit == "N m"
        # Over the angle of a revolute joint the frequency is in cycles per turn: those of gears and windings are whole
        # numbers.
        turn, highest = (2.0 * np.pi, HIGHEST_IN_A_RADIAN) if revolute else (1.0, HIGHEST_IN_A_METRE)
        q, dq = comparison.q[:, joint], comparison.dq[:, joint]
        try:
            _draw_spectrum(grid[row][1], angle_spectrum(q, dq, residual, highest), turn)
        except DynidentError as error:
            _draw_reason(grid[row][1], error.title)
        set_panel_title(grid[row][0], f"{name}, amplitude of the residual ({unit})")
        if row == len(joints) - 1:
            grid[row][0].set_xlabel("over time: frequency (Hz)", fontsize=8)
            grid[row][1].set_xlabel(
                "over the joint's position: cycles per turn (per metre on a linear joint)", fontsize=8
            )
    names = ", ".join(comparison.joint_names[j] for j in joints)
    return to_svg(figure, f"Amplitude spectra of the residual of {names} over time and over the joint's own position.")


def _draw_spectrum(axes: Axes, spectrum: ResidualSpectrum, scale: float) -> None:
    x, y = scale * spectrum.frequency, spectrum.amplitude
    step = max(1, -(-len(x) // _SPECTRUM_POINTS))
    parts = range(0, len(x), step)
    # Of every few values the highest is drawn, so that no spectral line is lost.
    rows = [first + int(np.argmax(y[first : first + step])) for first in parts]
    axes.fill_between(x[rows], y[rows], color=RESIDUAL, alpha=0.2, linewidth=0)
    axes.plot(x[rows], y[rows], color=RESIDUAL, linewidth=0.9)
    for k in filter(spectrum.is_line, spectrum.list_highest_peaks(_LABELLED_PEAKS)):
        axes.annotate(f"{x[k]:.3g}", (x[k], y[k]), (2, 1), textcoords="offset points", fontsize=7, color="#333333")
    axes.set_xlim(float(x[0]), float(x[-1]))
    axes.set_ylim(0, 1.2 * max(float(y.max()), 1e-12))


def _draw_reason(axes: Axes, reason: str) -> None:
    axes.text(0.5, 0.5, reason.lower(), ha="center", va="center", fontsize=8, color="#777777", transform=axes.transAxes)
    axes.set_xticks([])
    axes.set_yticks([])


_DENSITY_HEIGHT = 1.55
# Most cells of the density and most parts of the mean line; fewer where there are few rows, so that each has enough.
_MAX_CELLS, _MAX_MEANS = 90, 40
_ROWS_PER_CELL, _ROWS_PER_MEAN = 30, 25
_MIN_SAMPLES = 8
_TICKS = 6


def draw_residuals(comparisons: Sequence[Comparison], joints: Sequence[int]) -> Markup:
    """Draw the density of the residual over three signals, of all recordings together, with its mean.

    Parameters
    ----------
    comparisons : sequence of Comparison
        At least one, all of one robot.
    joints : sequence of int
        Indices of the joints to draw.

    Returns
    -------
    Markup
        An inline SVG.
    """
    figure, grid = make_panels(len(joints), 3, _DENSITY_HEIGHT)
    first = comparisons[0]
    for row, joint in enumerate(joints):
        residual = np.concatenate([c.residual[:, joint] for c in comparisons])
        angle = "rad" if first.units[joint] == "N m" else "m"
        signals = (
            ("velocity", f"{angle}/s", [c.dq[:, joint] for c in comparisons]),
            ("position", angle, [c.q[:, joint] for c in comparisons]),
            ("load torque", first.units[joint], [c.load[:, joint] for c in comparisons]),
        )
        for column, (name, unit, parts) in enumerate(signals):
            _draw_density(grid[row][column], np.concatenate(parts), residual)
            if row == len(joints) - 1:
                grid[row][column].set_xlabel(f"{name} ({unit})", fontsize=8)
        set_panel_title(grid[row][0], f"{first.joint_names[joint]}, residual ({first.units[joint]})")
    names = ", ".join(first.joint_names[j] for j in joints)
    return to_svg(
        figure,
        f"Residual torque of {names} over the joint's velocity, position and load torque: how often each value occurs, "
        "and the mean. A flat mean at zero shows no missing effect.",
    )


def _draw_density(axes: Axes, x: FloatArray, y: FloatArray) -> None:
    low, high = _find_range(x)
    # A few outliers must not shrink the rest to a line: they are drawn at the edge.
    reach = max(float(np.quantile(np.abs(y), 0.998)) * 1.15, 1e-12)
    across = int(np.clip(len(x) / _ROWS_PER_CELL, 24, _MAX_CELLS))
    cells = (across, across // 2)
    counts, _, _ = np.histogram2d(x, np.clip(y, -reach, reach), cells, ((low, high), (-reach, reach)))
    if counts.max() > 0:
        density = np.ma.masked_less(counts.T, 1)
        axes.imshow(
            density,
            origin="lower",
            extent=(low, high, -reach, reach),
            aspect="auto",
            cmap="Blues",
            # Counts span orders of magnitude. Beginning below one keeps a single sample visible.
            norm=LogNorm(0.3, max(float(counts.max()), 2.0)),
            interpolation="none",
            zorder=1,
        )
    axes.axhline(0, color="#777777", linewidth=0.6, zorder=2)
    centres, means = _compute_means(x, y, low, high)
    axes.plot(centres, means, color=PREDICTED, linewidth=1.4, zorder=3)
    axes.set_xlim(low, high)
    axes.set_ylim(-reach, reach)
    axes.locator_params(axis="x", nbins=_TICKS)


def _find_range(x: FloatArray) -> tuple[float, float]:
    """Return the range of the horizontal axis."""
    low, high = float(x.min()), float(x.max())
    if high - low < 1e-9 * max(1.0, abs(low)):
        # A joint that never moves has no range of its own.
        return low - 0.5, high + 0.5
    return low, high


def _compute_means(x: FloatArray, y: FloatArray, low: float, high: float) -> tuple[FloatArray, FloatArray]:
    """Return the centres of equal parts of x and the mean of y in each, NaN where there are too few samples."""
    n = int(np.clip(len(x) / _ROWS_PER_MEAN, _MIN_SAMPLES, _MAX_MEANS))
    which = np.clip(((x - low) / (high - low) * n).astype(np.intp), 0, n - 1)
    counts = np.bincount(which, minlength=n)
    sums = np.bincount(which, weights=y, minlength=n)
    means = np.where(counts >= _MIN_SAMPLES, sums / np.maximum(counts, 1), np.nan)
    return low + (np.arange(n) + 0.5) * (high - low) / n, means
