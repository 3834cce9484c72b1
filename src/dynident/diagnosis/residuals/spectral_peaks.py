"""Find peaks in the residual's spectra: over a joint's angle, over time, and of a shaking base.

Holds when a peak stands out (24 times its surroundings), and how many lines a joint may have (2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy import fft

from dynident.array_types import FloatArray, IndexArray
from dynident.diagnosis.comparison.measured_against_predicted import Comparison
from dynident.effects import ReferenceParameters, Signals
from dynident.expressions import Program
from dynident.robot.robot_model import Robot

# Range (Hz) in which a line is refined, and steps within the width of a line.
_AROUND, _STEPS_A_WIDTH = 0.3, 4
_STANDS_OUT, _MOST_LINES = 6.0, 2
"""Times what frequencies beside it explain (clean arms reach three), and the most frequencies that are tried."""
# Ridge that keeps the normal equations of a frequency solvable, as a share of their trace.
_SOLVABLE = 1e-9
_LEAST_FELT = 1e-3
"""Residuals of a joint for one m/s² of gravity: below it, a base that shakes by g moves the torque by less than a
hundredth of the residual. A link with its mass on a joint's axis feels nothing, or what rounding left."""
_MOST_ROWS = 6000


def find_base_vibration(
    comparisons: Sequence[Comparison],
    signals: Signals,
    reference: ReferenceParameters,
    highest: float,
    motion: MotionLines,
) -> list[float]:
    """Find frequencies (Hz) at which a shaking base explains far more of the residual than beside them, best first.

    Sought in what every joint would feel of it in its posture, not in the spectra of single joints: there it is spread
    over side lobes, and drowned by what noise other joints have.

    Parameters
    ----------
    reference : ReferenceParameters
        Parameters that torque is predicted with.
    highest : float
        Highest frequency that is looked for, Hz.
    motion : MotionLines
        Lines of the motion itself, which tell of the model, not of the base.
    comparisons : sequence of Comparison
        The recordings with the model's prediction.
    signals : Signals
        Signals of the model, with the torque that gravity makes.

    Returns
    -------
    list of float
        Frequencies, Hz.
    """
    felt = _build_gravity_program(signals)
    columns = [_compute_gravity_sensitivities(c, felt, reference) for c in comparisons]
    frequency, gains = _compute_vibration_spectrum(comparisons, columns, highest)
    lines = motion.exclude_motion_lines(find_peaks(frequency, gains, _STANDS_OUT))[:_MOST_LINES]
    longest = max(float(c.t[-1] - c.t[0]) for c in comparisons)
    step = 1.0 / (_STEPS_A_WIDTH * max(longest, np.finfo(float).tiny))
    frequencies: list[float] = []
    # Two peaks that a refinement would bring together are one line.
    for line in lines:
        if any(abs(line - other) <= 2 * _AROUND for other in frequencies):
            continue
        finer = np.arange(max(line - _AROUND, step), line + _AROUND, step)
        refined = [_compute_vibration_gain(comparisons, columns, float(value)) for value in finer]
        frequencies.append(float(finer[int(np.argmax(refined))]))
    return motion.exclude_motion_lines(frequencies)


def _compute_vibration_spectrum(
    comparisons: Sequence[Comparison], columns: Sequence[FloatArray], highest: float
) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (f,) in Hz, and the squared residual that a base shaking at each explains, a phase a segment.

    The normal equations of all frequencies at once: products with waves are Fourier transforms.
    """
    own = {id(c): values for c, values in zip(comparisons, columns, strict=True)}
    pieces = split_pieces(comparisons)
    period, size = choose_spectrum_grid(pieces)
    if not size or highest <= SLOWEST_VIBRATION:
        return np.zeros(0), np.zeros(0)
    in_range = np.flatnonzero(
        (fft.rfftfreq(size, period) >= SLOWEST_VIBRATION) & (fft.rfftfreq(size, period) < highest)
    )
    gains = np.zeros(len(in_range))
    for c, rows in pieces:
        felt, y = own[id(c)][rows], c.counted_residual[rows] * _compute_joint_weights(c)
        # Transforms need an even grid; rows that the filter left out stay zero on it.
        place = np.round((c.t[rows] - c.t[rows[0]]) / period).astype(np.intp)
        right, squares = np.zeros((place[-1] + 1, 3)), np.zeros((place[-1] + 1, 9))
        right[place] = np.einsum("mja,mj->ma", felt, y)
        squares[place] = np.einsum("mja,mjb->mab", felt, felt).reshape(-1, 9)
        wave = fft.fft(right, size, axis=0)[in_range]
        twice = fft.fft(squares, size, axis=0)[(2 * in_range) % size].reshape(-1, 3, 3)
        still = squares.sum(axis=0).reshape(3, 3)
        if not still.any():
            continue
        # cos² = (1 + cos 2ωt) / 2 and so on: products of waves of one frequency are the still part and that of twice
        # the frequency.
        w = np.block([[still + twice.real, -twice.imag], [-twice.imag, still - twice.real]]) / 2.0
        b = np.concatenate([wave.real, -wave.imag], axis=1)[..., None]
        w += _SOLVABLE * np.trace(still) * np.eye(6)
        gains += (b * np.linalg.solve(w, b)).sum(axis=(1, 2))
    return fft.rfftfreq(size, period)[in_range], gains


def _build_gravity_program(signals: Signals) -> Program:
    """Build the torque (m, 3 n) for one m/s² of gravity along each axis, of q (m, n) and the reference (14 n,)."""
    return Program([signals.q, signals.reference], ca.densify(signals.predicted.gravity_torques))


def _compute_gravity_sensitivities(comparison: Comparison, felt: Program, reference: ReferenceParameters) -> FloatArray:
    """Return (m, n, 3): torque for one m/s² of gravity along each axis, over the joint's usual residual.

    Zero where the joint's equation does not tell, and of joints that do not feel gravity.
    """
    values = felt(comparison.q, reference.vector).reshape(len(comparison.q), 3, -1).transpose(0, 2, 1)
    weighted = values * (comparison.counted_rows * _compute_joint_weights(comparison))[:, :, None]
    feels = np.abs(weighted).max(axis=(0, 2), initial=0.0) >= _LEAST_FELT
    return np.asarray(weighted * feels[:, None])


def _compute_joint_weights(comparison: Comparison) -> FloatArray:
    """Return (n,): one over every joint's usual residual, zero for one that has none, since it stands all the time."""
    rms = comparison.errors.rms
    return np.divide(1.0, rms, out=np.zeros_like(rms), where=rms > 0.0)


def _compute_vibration_gain(
    comparisons: Sequence[Comparison], columns: Sequence[FloatArray], frequency: float
) -> float:
    """Return the squared residual, in its own units, that a shaking base explains, with a phase for each recording."""
    total = 0.0
    for c, sensitivity in zip(comparisons, columns, strict=True):
        every = max(1, len(c.t) // _MOST_ROWS)
        angle = 2 * np.pi * frequency * c.t[::every]
        waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        w = (sensitivity[::every, ..., None] * waves[:, None, None, :]).reshape(-1, 6)
        y = (c.counted_residual[::every] * _compute_joint_weights(c)).reshape(-1)
        right = w.T @ y
        total += float(right @ np.linalg.lstsq(w.T @ w, right, rcond=1e-9)[0])
    return total


LINE_RATIO = 24.0
"""Times its surroundings from which on a line stands out (`benchmarks/lines_over_angles.py`).

It is only where to look: what a line explains has to pass the test of everything else."""

# Lines of a joint that are tried.
_LINES_A_JOINT = 2
# Lowest waves a turn (rad⁻¹), or in 2π m of a stroke (m⁻¹), and highest: screws have a lead of 4 mm or more,
# and a line at the end of the range would be cut.
_LOWEST_LINE, _HIGHEST_LINES = 2.0, {"revolute": 250.0, "prismatic": 2.0 * np.pi / 0.003}
_BINS = 200
# Least range of a joint (rad, m), and phase (rad) over the range by which the waves beside a line differ from it.
_LEAST_RANGES, _BESIDE = {"revolute": 0.2, "prismatic": 0.02}, 0.4
# Share of what the residual over the angle has beside a parabola: a slow wave with more of it is clear.
_CLEAR = 0.5
# Bins: twenty times the width of a line, nine bins, since its side lobes are as high as how unevenly a motion dwells.
_SURROUNDINGS = 181
# Hz: slower than this, a motion's own lines hide everything else.
SLOWEST_VIBRATION, _MOTION_LINE_RATIO = 1.0, 3.0


@dataclass(frozen=True)
class AngleLines:
    """Lines in the residual over a joint's own angle.

    Parameters
    ----------
    clear : tuple of (int, float)
        Lines that stand out: joint index, and waves a turn (in 2π m of a stroke).
    faint : tuple of (int, float)
        All waves of at most two cycles over the range: something else on the joint may hide them, and move what is left
        of them.
    """

    clear: tuple[tuple[int, float], ...] = ()
    faint: tuple[tuple[int, float], ...] = ()

    @property
    def joints(self) -> set[int]:
        """Indices of the joints with lines that stand out."""
        return {joint for joint, _ in self.clear}


def find_angle_lines(comparisons: Sequence[Comparison], robot: Robot) -> AngleLines:
    """Find lines in the spectrum of the residual over each joint's own angle or stroke."""
    clear, faint = [], []
    for j, joint in enumerate(robot.joints):
        q = np.concatenate([c.q[c.counted_rows[:, j], j] for c in comparisons])
        residual = np.concatenate([c.residual[c.counted_rows[:, j], j] for c in comparisons])
        if len(q) < _BINS:
            continue
        low, span = float(q.min()), float(q.max() - q.min())
        if span < _LEAST_RANGES[joint.kind]:
            continue
        power = compute_angle_power(q, residual, _HIGHEST_LINES[joint.kind])
        lines = find_peaks(*power, LINE_RATIO)[:_LINES_A_JOINT]
        slow, share = _find_slow_wave(q, residual, low, span)
        lines += [slow] if share > _CLEAR else []
        # A wave beside each, so that what a line is off by is not taken for something else.
        around = [offset / span for offset in (0.0, -_BESIDE, _BESIDE)]
        clear += [(j, line + offset) for line in lines for offset in around]
        faint += [(j, float(k)) for k in np.arange(_LOWEST_LINE, 4 * np.pi / span, 2 * _BESIDE / span)]
    return AngleLines(tuple(clear), tuple(faint))


def compute_line_share(comparisons: Sequence[Comparison], joint: int, waves: float) -> float:
    """Return the share of a joint's squared residual that a wave over its angle explains."""
    angle = np.concatenate([waves * c.q[c.counted_rows[:, joint], joint] for c in comparisons])
    residual = np.concatenate([c.residual[c.counted_rows[:, joint], joint] for c in comparisons])
    columns = np.column_stack([np.cos(angle), np.sin(angle)])
    right = columns.T @ residual
    explained = float(right @ np.linalg.lstsq(columns.T @ columns, right, rcond=1e-9)[0])
    return explained / max(float(residual @ residual), np.finfo(float).tiny)


def compute_angle_power(
    q: FloatArray, residual: FloatArray, highest: float = _HIGHEST_LINES["revolute"]
) -> tuple[FloatArray, FloatArray]:
    """Return waves a turn (f,) of more than two cycles over a joint's range, and their power (f,) in the residual.

    No part of the range counts for more than the middle one: a joint that goes from point to point is nearly always
    near the points, and the spectrum would be that of where it dwells.
    """
    low, span = float(q.min()), float(q.max() - q.min())
    part = _number_bins(q, low, span, _BINS)
    count = np.bincount(part, minlength=_BINS)
    weight = 1.0 / np.maximum(count, np.median(count[count > 0]))[part]
    # The same as the sum over all rows, but for the rounding of q to a sixteenth of the shortest wave.
    n_bins = int(np.ceil(span * highest / (2 * np.pi) * 16))
    varying = weight * (residual - float(weight @ residual / weight.sum()))
    sums = np.bincount(_number_bins(q, low, span, n_bins), weights=varying, minlength=n_bins)
    # Padding with zeros gives several values to the width of a line, so that no peak falls between two.
    size = fft.next_fast_len(9 * n_bins, real=True)
    k = 2 * np.pi * fft.rfftfreq(size, span / n_bins)
    in_range = (k >= max(_LOWEST_LINE, 4 * np.pi / span)) & (k <= highest)
    return k[in_range], np.asarray(np.abs(fft.rfft(sums, size)[in_range]) ** 2)


def _number_bins(q: FloatArray, low: float, span: float, count: int) -> IndexArray:
    """Return the number (m,) of the part of its range that an angle is in."""
    return np.asarray(np.minimum(((q - low) / span * count).astype(np.intp), count - 1))


def _find_slow_wave(q: FloatArray, residual: FloatArray, low: float, span: float) -> tuple[float, float]:
    """Return the wave of at most two cycles over the range that explains most beside a parabola, and its share.

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
    # Constant, slope and curvature are projected out of residual and waves alike.
    trend = np.linalg.qr(weight[:, None] * np.vander(x, 3))[0]
    y = y - trend @ (trend.T @ y)
    # All waves at once: each of these problems is small.
    angles = np.multiply.outer(waves, span * x)
    wave = weight[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    gains = ((y @ np.linalg.qr(wave - trend @ (trend.T @ wave))[0]) ** 2).sum(axis=1)
    best = int(np.argmax(gains))
    return float(waves[best]), float(gains[best]) / max(float(y @ y), np.finfo(float).tiny)


@dataclass(frozen=True)
class MotionLines:
    """Lines over time that the motion itself has.

    Parameters
    ----------
    lines : tuple of float
        Frequencies, Hz.
    apart : float
        Difference (Hz) below which two lines are the same.
    """

    lines: tuple[float, ...] = ()
    apart: float = 0.0

    def exclude_motion_lines(self, lines: Sequence[float]) -> list[float]:
        """Return those of some lines that are none of the motion."""
        return [f for f in lines if all(abs(f - other) > self.apart for other in self.lines)]


def find_motion_lines(comparisons: Sequence[Comparison], highest: float) -> MotionLines:
    """Find lines in the spectrum of all joints' velocities over time, below `highest` in Hz."""
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
    """Return all segments of all comparisons."""
    return [(c, rows) for c in comparisons for rows in split_segments(c)]


def choose_spectrum_grid(pieces: Sequence[Piece]) -> tuple[float, int]:
    """Return the seconds between rows, and the length of a spectrum that resolves the lines of the longest piece."""
    period = float(np.median(np.diff(pieces[0][0].t)))
    longest = max(float(c.t[rows[-1]] - c.t[rows[0]]) for c, rows in pieces)
    return period, fft.next_fast_len(4 * round(longest / period) + 4, real=True) if longest > 0.0 else 0


def split_segments(comparison: Comparison) -> list[NDArray[np.intp]]:
    """Return the rows of every segment."""
    edges = np.flatnonzero(np.diff(comparison.segment)) + 1
    return np.split(np.arange(len(comparison.t)), edges)


def _compute_periodogram(t: FloatArray, values: FloatArray, period: float, size: int) -> FloatArray:
    """Return the power (size // 2 + 1,) of signals (m, n), summed over them; rows that are missing count as zero."""
    place = np.round((t - t[0]) / period).astype(np.intp)
    grid = np.zeros((int(place[-1]) + 1, values.shape[1]))
    grid[place] = values - values.mean(axis=0)
    # A window, so that the ends of a piece make no lines of their own.
    grid *= np.hanning(len(grid))[:, None]
    return np.asarray((np.abs(fft.rfft(grid, size, axis=0)) ** 2).sum(axis=1) / max(len(t), 1))


def find_peaks(k: FloatArray, power: FloatArray, least: float) -> list[float]:
    """Find peaks of at least so many times their surroundings, the highest first."""
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
