"""The section on the residual over velocity, position and load, with its spectra."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from markupsafe import Markup

from dynident.reports.figures.residuals import draw_residuals
from dynident.reports.figures.spectra import draw_spectra
from dynident.reports.figures.torque import JOINTS_PER_FIGURE
from dynident.reports.run import ReportedRecording
from dynident.reports.section import Section


@dataclass(frozen=True)
class ResidualsContent:
    """The content of the section: the figures and the names of the recordings they show."""

    figures: tuple[Markup, ...]
    spectra: tuple[Markup, ...]
    spectra_of: str
    names: tuple[str, ...]
    held_out: bool


def build_residuals_section(runs: Sequence[ReportedRecording]) -> Section:
    """Return the section on the residual over the signals that missing physics would depend on.

    Parameters
    ----------
    runs : sequence of ReportedRun
        The held-out ones are shown, or all where there are none.

    Returns
    -------
    Section
    """
    shown_runs = [run for run in runs if run.held_out] or list(runs)
    comparisons = [run.comparison for run in shown_runs]
    # Recordings cannot be joined for a spectrum; the longest has the finest resolution.
    longest = max(shown_runs, key=lambda run: len(run.comparison.t))
    n = len(comparisons[0].joint_names)
    parts = [range(first, min(first + JOINTS_PER_FIGURE, n)) for first in range(0, n, JOINTS_PER_FIGURE)]
    content = ResidualsContent(
        tuple(draw_residuals(comparisons, joints) for joints in parts),
        tuple(draw_spectra(longest.comparison, joints) for joints in parts),
        longest.name,
        tuple(run.name for run in shown_runs),
        any(run.held_out for run in shown_runs),
    )
    return Section("residuals", "What is left", "residuals", content)
