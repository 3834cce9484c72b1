"""Spectra of the residual over time and over each joint's own position."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.diagnosis import Comparison, ResidualSpectrum, angle_spectrum, time_spectrum
from dynident.diagnosis.comparing.spectrum import HIGHEST_IN_A_METRE, HIGHEST_IN_A_RADIAN
from dynident.errors import DynidentError
from dynident.reports.figures.svg import RESIDUAL, make_panels, set_panel_title, to_svg

_SPECTRUM_HEIGHT = 1.35
_SPECTRUM_POINTS = 500
_LABELLED_PEAKS = 2


def draw_spectra(comparison: Comparison, joints: range) -> Markup:
    """Draw amplitude spectra of some joints' residual in one recording.

    Parameters
    ----------
    comparison : Comparison
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
