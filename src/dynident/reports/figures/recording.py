"""A recording as it was measured: position and torque of every joint over time."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from dynident.arrays import FloatArray
from dynident.recordings import Recording
from dynident.reports.figures.svg import MEASURED, RESIDUAL, STANDING, panel_title, panels, to_svg

_ROW = 1.25
_PARTS = 400
_BLOCK = 1 << 16
_PAUSE = 0.02
_REVOLUTE_UNITS, _PRISMATIC_UNITS = ("rad", "N m"), ("m", "N")


def recording_figure(recording: Recording, prismatic: tuple[bool, ...] = ()) -> Markup:
    """Position and torque of every joint; seconds outside of the windows are grey.

    Parameters
    ----------
    recording : Recording
        Read in a stream; of every part of it the extremes are drawn.
    prismatic : which of the joints slide, in the robot's order
        Empty: none of them.
    """
    t, q, tau, shifted = _series(recording)
    figure, grid = panels(recording.n, 2, _ROW)
    for joint, name in enumerate(recording.joint_names):
        units = _PRISMATIC_UNITS if prismatic and prismatic[joint] else _REVOLUTE_UNITS
        for axes, values, what, unit, colour in zip(
            grid[joint], (q, tau), ("position", "torque"), units, (RESIDUAL, MEASURED), strict=True
        ):
            axes.plot(t[:, joint], values[:, joint], color=colour, linewidth=0.9)
            panel_title(axes, f"{name}, {what} ({unit})")
            axes.set_xlim(float(np.nanmin(t)), float(np.nanmax(t)))
            if not shifted:
                _outside(axes, recording)
    for axes in grid[-1]:
        axes.set_xlabel("time, runs one after another (s)" if shifted else "time (s)", fontsize=8)
    return to_svg(
        figure,
        f"Position and torque of {', '.join(recording.joint_names)} in {recording.name}, "
        f"{recording.n_samples * recording.period:.4g} s.",
    )


def _outside(axes: Axes, recording: Recording) -> None:
    """A grey ground where nothing is used."""
    low, high = axes.get_xlim()
    edges = [low, *(edge for window in sorted(recording.windows) for edge in window), high]
    for start, end in zip(edges[::2], edges[1::2], strict=True) if recording.windows else ():
        if end > start:
            axes.axvspan(start, end, color=STANDING, zorder=0, linewidth=0)


def _series(recording: Recording) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """t, q, tau (k, n) with NaN between segments; whether runs that overlap in time were set one after another."""
    size = max(1, recording.n_samples // _PARTS)
    pause = _PAUSE * recording.n_samples * recording.period
    gap = np.full((1, recording.n), np.nan)
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    end, shift, shifted = -np.inf, 0.0, False
    for segment in recording.segments:
        if parts:
            parts.append((gap, gap, gap))
            if segment.start_time + shift < end:
                shift, shifted = end + pause - segment.start_time, True
        done = 0
        for rows in recording.source.rows(segment.first_row, segment.length, _BLOCK):
            times = (
                segment.start_time + shift + recording.period * np.arange(done, done + len(rows.q), dtype=np.float64)
            )
            parts += _extremes(times, rows.q, rows.tau, size)
            done += len(rows.q)
        end = segment.start_time + shift + segment.length * recording.period
    t, q, tau = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    return t, q, tau, shifted


def _extremes(
    t: FloatArray, q: FloatArray, tau: FloatArray, size: int
) -> Iterator[tuple[FloatArray, FloatArray, FloatArray]]:
    """Of every `size` rows those where a joint's torque is first, least and largest, in their order, (3, n) each."""
    joints = np.arange(q.shape[1])
    for first in range(0, len(t), size):
        part = tau[first : first + size]
        kept = first + np.sort([np.zeros(len(joints), dtype=int), part.argmin(axis=0), part.argmax(axis=0)], axis=0)
        yield t[kept], q[kept, joints], tau[kept, joints]
