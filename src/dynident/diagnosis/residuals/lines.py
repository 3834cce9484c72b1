"""Lines in the residual's spectra: over a joint's own angle, and over time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft

from dynident.arrays import FloatArray, IndexArray
from dynident.diagnosis.comparing.compare import Comparison
from dynident.robot.model import Robot

LINE_RATIO = 24.0
"""Times its surroundings from which on a line stands out (`benchmarks/lines_over_angles.py`).

It is only where to look: what a line explains has to pass the test of everything else."""

_LINES_A_JOINT = 2
_LOWEST_LINE, _HIGHEST_LINE = 2.0, 250.0
_BINS = 200
_LEAST_ANGLE, _BESIDE = 0.2, 0.4
# Share of what the residual over the angle has beside a parabola: a slow wave with more of it is clear.
_CLEAR = 0.5
# Bins: twenty times the width of a line, nine bins, since its side lobes are as high as how unevenly a motion dwells.
_SURROUNDINGS = 181
# Hz: slower than this, a motion's own lines hide everything else.
SLOWEST_VIBRATION, _MOTION_LINE_RATIO = 1.0, 3.0


@dataclass(frozen=True)
class AngleLines:
    """Lines in the residual over a joint's own angle: (joint index, waves per turn).

    `clear` ones stand out of it; `faint` are all of at most two cycles: something else on the joint may hide them, and
    move what is left of them.
    """

    clear: tuple[tuple[int, float], ...] = ()
    faint: tuple[tuple[int, float], ...] = ()


def find_angle_lines(comparisons: Sequence[Comparison], robot: Robot) -> AngleLines:
    """Lines in the spectrum of the residual over each joint's own angle."""
    clear, faint = [], []
    for j, joint in enumerate(robot.joints):
        if joint.kind != "revolute":
            continue
        q = np.concatenate([c.q[c.counted_rows[:, j], j] for c in comparisons])
        residual = np.concatenate([c.residual[c.counted_rows[:, j], j] for c in comparisons])
        if len(q) < _BINS:
            continue
        low, span = float(q.min()), float(q.max() - q.min())
        if span < _LEAST_ANGLE:
            continue
        lines = find_peaks(*compute_angle_power(q, residual), LINE_RATIO)[:_LINES_A_JOINT]
        slow, share = _find_slow_wave(q, residual, low, span)
        lines += [slow] if share > _CLEAR else []
        # A wave beside each, so that what a line is off by is not taken for something else.
        around = [offset / span for offset in (0.0, -_BESIDE, _BESIDE)]
        clear += [(j, line + offset) for line in lines for offset in around]
        faint += [(j, float(k)) for k in np.arange(_LOWEST_LINE, 4 * np.pi / span, 2 * _BESIDE / span)]
    return AngleLines(tuple(clear), tuple(faint))


def compute_angle_power(q: FloatArray, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Waves per radian (f,) of more than two cycles over a joint's range, and their power (f,) in the residual (m,).

    No part of the range counts for more than the middle one: a joint that goes from point to point is nearly always
    near the points, and the spectrum would be that of where it dwells.
    """
    low, span = float(q.min()), float(q.max() - q.min())
    part = _number_bins(q, low, span, _BINS)
    count = np.bincount(part, minlength=_BINS)
    weight = 1.0 / np.maximum(count, np.median(count[count > 0]))[part]
    # The same as the sum over all rows, but for the rounding of q to a sixteenth of the shortest wave.
    n_bins = int(np.ceil(span * _HIGHEST_LINE / (2 * np.pi) * 16))
    varying = weight * (residual - float(weight @ residual / weight.sum()))
    sums = np.bincount(_number_bins(q, low, span, n_bins), weights=varying, minlength=n_bins)
    size = fft.next_fast_len(9 * n_bins, real=True)
    k = 2 * np.pi * fft.rfftfreq(size, span / n_bins)
    in_range = (k >= max(_LOWEST_LINE, 4 * np.pi / span)) & (k <= _HIGHEST_LINE)
    return k[in_range], np.asarray(np.abs(fft.rfft(sums, size)[in_range]) ** 2)


def _number_bins(q: FloatArray, low: float, span: float, count: int) -> IndexArray:
    """(m,): in which of so many parts of its range an angle is."""
    return np.asarray(np.minimum(((q - low) / span * count).astype(np.intp), count - 1))


def _find_slow_wave(q: FloatArray, residual: FloatArray, low: float, span: float) -> tuple[float, float]:
    """The wave of at most two cycles over the joint's range that explains most beside a parabola, and the share of it.

    A spectrum cannot tell so few cycles from a trend.
    """
    waves = np.arange(_LOWEST_LINE, 4 * np.pi / span, 0.05 / span)
    place = _number_bins(q, low, span, _BINS)
    counts = np.bincount(place, minlength=_BINS).astype(np.float64)
    filled = counts > 0
    if not len(waves) or filled.sum() < 10:
        return _LOWEST_LINE, 0.0
    weight = np.sqrt(counts[filled])
    y = weight * np.bincount(place, weights=residual, minlength=_BINS)[filled] / counts[filled]
    x = (np.flatnonzero(filled) + 0.5) / _BINS
    trend = np.linalg.qr(weight[:, None] * np.vander(x, 3))[0]
    y = y - trend @ (trend.T @ y)
    gains = []
    for k in waves:
        angle = k * span * x
        wave = weight[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        wave = np.linalg.qr(wave - trend @ (trend.T @ wave))[0]
        gains.append(float(((wave.T @ y) ** 2).sum()))
    best = int(np.argmax(gains))
    return float(waves[best]), gains[best] / max(float(y @ y), np.finfo(float).tiny)


@dataclass(frozen=True)
class MotionLines:
    """Lines (Hz) over time that the motion has; lines nearer than `apart` are the same."""

    lines: tuple[float, ...] = ()
    apart: float = 0.0

    def exclude_motion_lines(self, lines: Sequence[float]) -> list[float]:
        """Those of some lines that are none of the motion."""
        return [f for f in lines if all(abs(f - other) > self.apart for other in self.lines)]


def find_motion_lines(comparisons: Sequence[Comparison], highest: float) -> MotionLines:
    """Lines in the spectrum of all joints' velocities over time, below `highest` in Hz."""
    pieces = split_pieces(comparisons)
    period, size = choose_spectrum_grid(pieces)
    if not size or highest <= SLOWEST_VIBRATION:
        return MotionLines()
    frequency = fft.rfftfreq(size, period)
    motion = np.zeros(len(frequency))
    spread = {id(c): np.maximum(c.dq.std(axis=0), 1e-300) for c in comparisons}
    for c, rows in pieces:
        motion += _compute_periodogram(c.t[rows], c.dq[rows] / spread[id(c)], period, size)
    in_range = (frequency >= SLOWEST_VIBRATION) & (frequency < highest)
    longest = max(float(c.t[rows[-1]] - c.t[rows[0]]) for c, rows in pieces)
    return MotionLines(tuple(find_peaks(frequency[in_range], motion[in_range], _MOTION_LINE_RATIO)), 1.0 / longest)


Piece = tuple[Comparison, NDArray[np.intp]]
"""A comparison and the rows of one of its segments."""


def split_pieces(comparisons: Sequence[Comparison]) -> list[Piece]:
    """All segments of all comparisons."""
    return [(c, rows) for c in comparisons for rows in split_segments(c)]


def choose_spectrum_grid(pieces: Sequence[Piece]) -> tuple[float, int]:
    """Seconds between rows, and the length of a spectrum that resolves the longest piece's lines; 0: there are none."""
    period = float(np.median(np.diff(pieces[0][0].t)))
    longest = max(float(c.t[rows[-1]] - c.t[rows[0]]) for c, rows in pieces)
    return period, fft.next_fast_len(4 * round(longest / period) + 4, real=True) if longest > 0.0 else 0


def split_segments(comparison: Comparison) -> list[NDArray[np.intp]]:
    """The rows of every segment."""
    edges = np.flatnonzero(np.diff(comparison.segment)) + 1
    return np.split(np.arange(len(comparison.t)), edges)


def _compute_periodogram(t: FloatArray, values: FloatArray, period: float, size: int) -> FloatArray:
    """Power (size // 2 + 1,) of signals (m, n), summed over them; rows that are missing count as zero."""
    place = np.round((t - t[0]) / period).astype(np.intp)
    grid = np.zeros((int(place[-1]) + 1, values.shape[1]))
    grid[place] = values - values.mean(axis=0)
    grid *= np.hanning(len(grid))[:, None]
    return np.asarray((np.abs(fft.rfft(grid, size, axis=0)) ** 2).sum(axis=1) / max(len(t), 1))


def find_peaks(k: FloatArray, power: FloatArray, least: float) -> list[float]:
    """Peaks of at least so many times their surroundings, the highest first."""
    if len(power) < 3:
        return []
    width = min(_SURROUNDINGS, 2 * ((len(power) - 1) // 2) + 1)
    padded = np.pad(power, width // 2, mode="reflect")
    surrounding = np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)
    ratio = power / np.maximum(surrounding, np.finfo(float).tiny)
    inner = np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:])) + 1
    frequencies = []
    for i in sorted((i for i in inner if ratio[i] > least), key=lambda i: -power[i]):
        a, b, c = power[i - 1], power[i], power[i + 1]
        # A parabola through the three highest values gives the peak between two frequencies of the grid.
        shift = 0.5 * (a - c) / (a - 2 * b + c)
        frequencies.append(float(k[i] + shift * (k[1] - k[0])))
    return frequencies
