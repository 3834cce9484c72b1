"""A recording as it was measured: position and torque of every joint over time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.array_types import FloatArray
from dynident.recordings import Recording
from dynident.reports.figures.svg import MEASURED, RESIDUAL, STANDING, make_panels, set_panel_title, to_svg

_ROW = 1.25
# A recording is cut into so many parts, each of which is drawn by its extremes.
_MAX_PARTS = 400
# Rows that are read at a time: some megabytes, however long the recording.
_ROWS_PER_READ = 1 << 16
# Between segments that are set one after another, a share of the whole time.
_PAUSE_SHARE = 0.02
_REVOLUTE_UNITS, _PRISMATIC_UNITS = ("rad", "N m"), ("m", "N")


def draw_recording(recording: Recording, prismatic: tuple[bool, ...] = ()) -> Markup:
    """Draw position and torque of every joint; times outside of the windows are grey.

    Parameters
    ----------
    recording : Recording
        Read as a stream, so that it need not fit in memory.
    prismatic : tuple of bool
        Which of the joints slide, in the robot's order; empty: none of them.

    Returns
    -------
    Markup
        An inline SVG.
    """
    t, q, tau, shifted = _read_series(recording)
    figure, grid = make_panels(recording.n, 2, _ROW)
    for joint, name in enumerate(recording.joint_names):
        units = _PRISMATIC_UNITS if prismatic and prismatic[joint] else _REVOLUTE_UNITS
        for axes, values, quantity, unit, colour in zip(
            grid[joint], (q, tau), ("position", "torque"), units, (RESIDUAL, MEASURED), strict=True
        ):
            axes.plot(t[:, joint], values[:, joint], color=colour, linewidth=0.9)
            set_panel_title(axes, f"{name}, {quantity} ({unit})")
            axes.set_xlim(float(np.nanmin(t)), float(np.nanmax(t)))
            # Windows are times of the recording: on an axis whose segments were moved they would be wrong.
            if not shifted:
                _shade_unused(axes, recording)
    for axes in grid[-1]:
        axes.set_xlabel("time, runs one after another (s)" if shifted else "time (s)", fontsize=8)
    return to_svg(
        figure,
        f"Position and torque of {', '.join(recording.joint_names)} in {recording.name}, "
        f"{recording.n_samples * recording.period:.4g} s.",
    )


def _shade_unused(axes: Axes, recording: Recording) -> None:
    """Shade the times that are not used."""
    low, high = axes.get_xlim()
    # The edges in pairs are the gaps before, between and behind the windows.
    edges = [low, *(edge for window in sorted(recording.windows) for edge in window), high]
    for start, end in zip(edges[::2], edges[1::2], strict=True) if recording.windows else ():
        if end > start:
            axes.axvspan(start, end, color=STANDING, zorder=0, linewidth=0)


def _read_series(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """Return t, q, tau (k, n) with NaN between segments, and whether overlapping segments were moved apart."""
    size = max(1, recording.n_samples // _MAX_PARTS)
    pause = _PAUSE_SHARE * recording.n_samples * recording.period
    gap = np.full((1, recording.n), np.nan)
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    end, shift, shifted = -np.inf, 0.0, False
    for segment in recording.segments:
        if parts:
            parts.append((gap, gap, gap))
            # Segments may have clocks of their own: one that would lie on top of another is moved behind it.
            if segment.start_time + shift < end:
                shift, shifted = end + pause - segment.start_time, True
        done = 0
        for rows in recording.source.rows(segment.first_row, segment.length, _ROWS_PER_READ):
            times = (
                segment.start_time + shift + recording.period * np.arange(done, done + len(rows.q), dtype=np.float64)
            )
            parts += _find_extreme_rows(times, rows.q, rows.tau, size)
            done += len(rows.q)
        end = segment.start_time + shift + segment.length * recording.period
    t, q, tau = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return t, q, tau, shifted


def _find_extreme_rows(
    t: FloatArray, q: FloatArray, tau: FloatArray, size: int
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Yield, of every `size` rows, those where a joint's torque is first, least and largest, (3, n) each."""
    joints = np.arange(q.shape[1])
    for first in range(0, len(t), size):
        part = tau[first : first + size]
        # Each joint has rows of its own. Sorted, they keep the order of time.
        rows = first + np.sort([np.zeros(len(joints), dtype=int), part.argmin(axis=0), part.argmax(axis=0)], axis=0)
        yield t[rows], q[rows, joints], tau[rows, joints]
