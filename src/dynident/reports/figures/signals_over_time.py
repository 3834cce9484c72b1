"""Figures over time by joint: a recording as measured, measured against predicted torque; series are thinned.

Long series are thinned for a figure: few points, all extremes, and gaps where nothing was measured.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray
from dynident.diagnosis import Comparison
from dynident.number_format import format_percent
from dynident.recordings import Recording
from dynident.recordings.joint_phases import Phase
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

# A step in time above so many usual steps is a gap, in which no line is drawn.
_GAP_RATIO = 1.5
# Between segments that are set one after another, a share of the whole time.
_PAUSE_SHARE = 0.02


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """The positions of a comparison's samples on the time axis of a figure.

    Attributes
    ----------
    t : (m,) array
        Increases throughout: segments that overlap in time are set one after another.
    intervals : tuple of slice
        Samples without a gap between them.
    shifted : bool
        True where segments were set one after another.
    """

    t: FloatArray
    intervals: tuple[slice, ...]
    shifted: bool

    @property
    def label(self) -> str:
        """The text at the axis."""
        return "time, runs one after another (s)" if self.shifted else "time (s)"

    def restrict(self, rows: BoolArray) -> TimeAxis:
        """Return the axis with its intervals cut down to some of the rows.

        Parameters
        ----------
        rows : (m,) array of bool
            Which samples remain.

        Returns
        -------
        TimeAxis
            The same times, with other intervals.
        """
        # The intervals are cut wherever `rows` changes; each piece then is wanted, or not, as a whole.
        changes = np.flatnonzero(np.diff(rows)) + 1
        pieces: list[slice] = []
        for part in self.intervals:
            inner = changes[(changes > part.start) & (changes < part.stop)].tolist()
            pieces += [slice(a, b) for a, b in pairwise([part.start, *inner, part.stop]) if rows[a]]
        return replace(self, intervals=tuple(pieces))


def build_time_axis(comparison: Comparison) -> TimeAxis:
    """Return the time axis of a comparison's samples.

    Parameters
    ----------
    comparison : Comparison
        Measured and predicted torque.

    Returns
    -------
    TimeAxis
        The axis of all samples.
    """
    t = comparison.t.copy()
    steps = np.diff(t)
    # Decimated segments may differ in their step; the median step within segments is the usual one.
    forward = steps[(steps > 0) & (np.diff(comparison.segment) == 0)]
    usual_step = float(np.median(forward)) if len(forward) else 0.0
    broken = (np.diff(comparison.segment) != 0) | (steps <= 0) | (steps > _GAP_RATIO * usual_step)
    borders = [0, *(np.flatnonzero(broken) + 1).tolist(), len(t)]
    intervals = tuple(slice(first, last) for first, last in pairwise(borders) if last > first)
    shifted = False
    pause = _PAUSE_SHARE * sum(float(t[part][-1] - t[part][0]) for part in intervals)
    for before, after in pairwise(intervals):
        # Only what would lie on top of the interval before it is moved, together with all that follows.
        if t[after.start] <= t[before.stop - 1]:
            t[after.start :] += t[before.stop - 1] + max(pause, usual_step) - t[after.start]
            shifted = True
    return TimeAxis(t, intervals, shifted)


def thin_series(axis: TimeAxis, values: FloatArray, points: int) -> tuple[FloatArray, FloatArray]:
    """Thin out a series to some points, with the extremes of every part of it and NaN between intervals.

    Parameters
    ----------
    axis : TimeAxis
        Where the samples stand on the time axis.
    values : (m,) array
        Values of all samples.
    points : int
        About how many remain.

    Returns
    -------
    t, values : (k,)
        Times and values of the points that remain.
    """
    t, thin_values = thin_series_together(axis, points, values)
    return t, thin_values


def thin_series_together(axis: TimeAxis, points: int, *series: FloatArray) -> tuple[FloatArray, ...]:
    """Thin out several series at common times, with the extremes of each.

    Parameters
    ----------
    axis : TimeAxis
        Where the samples stand on the time axis.
    points : int
        About how many remain of each series.
    series : tuple of (m,)
        Values of all samples, of one series each.

    Returns
    -------
    tuple of arrays
        The times, then each series, all of the same length.
    """
    total = len(axis.t)
    parts: list[list[FloatArray]] = [[] for _ in range(len(series) + 1)]
    for part in axis.intervals:
        length = part.stop - part.start
        # Two extremes of each part are kept, so that half as many parts give the number of points.
        bins = max(1, round(0.5 * points * length / total))
        # The series share their times, so that an area between two of them can be filled.
        rows = part.start + np.unique(np.concatenate([find_extremes(values[part], bins) for values in series]))
        for k, values in enumerate((axis.t, *series)):
            # A NaN breaks the line between intervals; its time has to be a number.
            if parts[k]:
                parts[k].append(axis.t[rows[:1]] if k == 0 else np.array([np.nan]))
            parts[k].append(values[rows])
    return tuple(np.concatenate(part) if part else np.empty(0) for part in parts)


def find_extremes(values: FloatArray, bins: int) -> NDArray[np.intp]:
    """Return the indices of the first, last, least and largest values of equal parts of a series.

    Parameters
    ----------
    values : (m,) array
        Values of the series.
    bins : int
        Number of parts.

    Returns
    -------
    (k,) array of int
        Ascending; the first and the last of the series, and the least and the largest of every part.
    """
    m = len(values)
    if m <= 2 * bins + 2:
        return np.arange(m)
    size = -(-m // bins)
    # Repeating the last value fills the last part without a new extreme.
    padded = np.concatenate([values, np.full(size * bins - m, values[-1])]).reshape(bins, size)
    first = np.arange(bins) * size
    indices = np.concatenate([[0, m - 1], first + padded.argmin(axis=1), first + padded.argmax(axis=1)])
    return np.unique(np.minimum(indices, m - 1))


_ROW = 1.25
# A recording is cut into so many parts, each of which is drawn by its extremes.
_MAX_PARTS = 400
# Rows that are read at a time: some megabytes, however long the recording.
_ROWS_PER_READ = 1 << 16
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


_POINTS = 700
_BAND_POINTS = 300
_PANEL_HEIGHT = 1.6
# Halts of a joint that are nearer than this share of the axis are drawn as one: paper does not separate them.
_MIN_SEPARATION = 0.002
_STANDSTILL_LABELS = ("standstill", "range of static friction at standstill")
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
    axes.fill_between(
        t, lower, upper, color=AT_REST, alpha=0.6, linewidth=0.6, label="range of static friction at standstill"
    )
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
    for part in axis.restrict(standing).intervals:
        first, last = float(axis.t[part.start]), float(axis.t[part.stop - 1])
        if spans and first - spans[-1][1] < least:
            spans[-1][1] = last
        else:
            spans.append([first, last])
    across = [(first, last - first) for first, last in spans]
    ground = axes.get_xaxis_transform()
    axes.broken_barh(across, (0, 1), transform=ground, facecolors=STANDING, linewidth=0, zorder=0, label="stands")


def _set_time_range(axes: Axes, axis: TimeAxis) -> None:
    margin = 0.01 * float(axis.t[-1] - axis.t[0])
    axes.set_xlim(float(axis.t[0]) - margin, float(axis.t[-1]) + margin)


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
        + (f", at standstill in {format_percent(float(stands[j]), 2)} of the rows" if stands[j] > 0 else "")
        for j in joints
    ]
    return f"Measured and predicted torque of {name} over time, and the residual with its band. {'; '.join(parts)}."
