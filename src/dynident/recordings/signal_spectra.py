"""Power spectra of velocity, position noise and torque (Welch), for cut-offs; steps and slopes of signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, special

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.recordings.recording import Recording

LONGEST = 20.0
"""Seconds under one window: resolves a motion of 0.1 Hz."""

FEWEST_ROWS = 8
"""Rows of a window with frequencies above the three that the taper spoils, and some for the noise."""

MAX_WINDOWS = 128


@dataclass(frozen=True, eq=False)
class Spectra:
    """One-sided power spectral densities, of the rows inside the windows.

    Parameters
    ----------
    frequency : (k,)
        Frequencies in Hz, from 0 on.
    velocity : (k, n)
        Density of q̇ in (rad/s)²/Hz, or (m/s)²/Hz.
    noise : (n,)
        Floor of the density of q in rad²/Hz, or m²/Hz: white noise, as the highest frequencies show it.
    torque : (k, n)
        Density of τ about its mean, in (N m)²/Hz, or N²/Hz.
    rate : float
        Sampling rate in Hz.
    windows : int
        Number of parts of the recording that the densities are means over.
    torque_squared : float
        Mean of τ², its own mean included, of all joints together.
    """

    frequency: FloatArray
    velocity: FloatArray
    noise: FloatArray
    torque: FloatArray
    rate: float
    windows: int
    torque_squared: float = 0.0

    @property
    def velocity_gain(self) -> FloatArray:
        """Squared gain (k,) from q to q̇."""
        return (2.0 * self.rate * np.sin(np.pi * self.frequency / self.rate)) ** 2


def estimate_spectra(recording: Recording) -> Spectra:
    """Estimate the spectra from at most `MAX_WINDOWS` half-overlapping parts, spread evenly over all windows.

    Parameters
    ----------
    recording : Recording
        The checked recording.

    Returns
    -------
    Spectra
        Means over all these parts.

    Raises
    ------
    DynidentError
        If no part inside the windows is long enough to have a spectrum.
    """
    runs = find_used_runs(recording)
    longest = max((length for _, length in runs), default=0)
    if longest < 32:
        raise DynidentError(
            f"Recording {recording.name} has at most {longest} consecutive samples inside its windows; these are too "
            "few to choose the filters. Give the cut-off frequencies, or wider windows.",
            pointer="/preprocessing",
        )
    # A length of small prime factors: the Fourier transform is many times faster.
    length = fft.prev_fast_len(min(longest, int(LONGEST * recording.sampling_rate) + 1), real=True)
    if length < FEWEST_ROWS:
        raise DynidentError(
            f"Recording {recording.name} has {recording.sampling_rate:.3g} rows a second: too few to choose the "
            "filters. Check whether the time is in seconds.",
            pointer="/preprocessing",
        )
    starts = [first + offset for first, run in runs for offset in range(0, run - length + 1, max(1, length // 2))]
    if len(starts) > MAX_WINDOWS:
        starts = [starts[index] for index in np.linspace(0, len(starts) - 1, MAX_WINDOWS).astype(int)]
    # Hann's window, periodic.
    taper = 0.5 + 0.5 * np.cos(np.linspace(-np.pi, np.pi, length + 1)[:-1])
    scale = 2.0 / (recording.sampling_rate * float((taper**2).sum()))
    taper = taper[:, None]
    velocity = torque = np.zeros((length // 2 + 1, recording.n))
    squared = 0.0
    for start in starts:
        q, tau = _read_rows(recording, start, length)
        speed = np.empty_like(q)
        # The first sample has none before it in this part: it takes the speed of the second one.
        speed[1:] = np.diff(q, axis=0) * recording.sampling_rate
        speed[0] = speed[1]
        # Velocity instead of position: its spectrum is level enough not to leak through the window.
        velocity = velocity + scale * np.abs(fft.rfft(taper * speed, axis=0)) ** 2
        squared += float((tau**2).sum()) / length
        torque = torque + scale * np.abs(fft.rfft(taper * (tau - tau.mean(axis=0)), axis=0)) ** 2
    frequency = fft.rfftfreq(length, 1.0 / recording.sampling_rate)
    velocity, torque = velocity / len(starts), torque / len(starts)
    gain = (2.0 * recording.sampling_rate * np.sin(np.pi * frequency / recording.sampling_rate)) ** 2
    # Positions of a robot hold no motion up here, only noise; close to the Nyquist frequency the gain is uncertain.
    high = (frequency > 0.3 * recording.sampling_rate) & (frequency < 0.48 * recording.sampling_rate)
    # Median over mean of a chi-squared density, of two degrees of freedom for every window.
    bias = float(special.gammaincinv(len(starts), 0.5)) / len(starts)
    noise = np.median(velocity[high] / gain[high, None], axis=0) / bias
    count = len(starts)
    return Spectra(frequency, velocity, noise, torque, recording.sampling_rate, count, squared / count)


def find_used_runs(recording: Recording) -> Sequence[tuple[int, int]]:
    """Return the runs of rows of one segment that lie inside one window.

    Parameters
    ----------
    recording : Recording
        The checked recording.

    Returns
    -------
    list of pair of int
        First stored row and length of every run.
    """
    runs = []
    for segment in recording.segments:
        windows = recording.windows or ((-np.inf, np.inf),)
        for start, end in windows:
            slack = 1e-6
            low = np.ceil(np.clip((start - segment.start_time) * recording.sampling_rate - slack, 0, segment.length))
            high = np.floor(
                np.clip((end - segment.start_time) * recording.sampling_rate + slack, -1, segment.length - 1)
            )
            if high >= low:
                runs.append((segment.first_row + int(low), int(high - low) + 1))
    return runs


def _read_rows(recording: Recording, first: int, length: int) -> tuple[FloatArray, FloatArray]:
    parts = list(recording.source.rows(first, length, length))
    if len(parts) == 1:
        return parts[0].q, parts[0].tau
    return np.concatenate([rows.q for rows in parts]), np.concatenate([rows.tau for rows in parts])


def find_step(values: FloatArray) -> float:
    """Return the step that a signal comes in, 0 if it shows none.

    Parameters
    ----------
    values : (m,)
        The signal.

    Returns
    -------
    float
    """
    levels = np.unique(values)
    levels = levels[np.concatenate([[True], np.diff(levels) > 1e-9 * max(float(np.ptp(values)), 1e-300)])]
    # Hardly any value occurs twice: the signal is continuous, or noise is larger than the steps.
    if len(levels) < 3 or len(levels) > 0.5 * len(values):
        return 0.0
    gaps = np.diff(levels)
    # Not the smallest gap itself: rounded digits make some gaps a little smaller than a step, and missing levels make
    # others twice as large.
    step = float(np.median(gaps[gaps < 1.5 * gaps.min() + 1e-300]))
    whole = gaps / step
    # A grid: all gaps are whole numbers of steps.
    return step if np.median(np.abs(whole - np.rint(whole))) < 0.05 else 0.0


_FEWEST_LEVELS, _FEWEST_PASSES, _BESIDE, _FAR, _WITHIN, _WIDEST = 10, 6, 2.0, 1.5, 3.0, 0.25
"""Values between a threshold and twice it, without which it may be a step of the signal; passes to or from 0; the
threshold's multiple that half of the values beside zeros stay below, unlike where a drive is switched; the one that the
largest tenth of all exceeds, unlike steps of one size; and the one up to which sizes leave no gap wider than a share of
the threshold, unlike steps times a factor that varies."""


def find_dead_zone(tau: FloatArray, q: FloatArray) -> float:
    """Return the size below which a driver reports torques as 0, while their joint moves; 0 if it shows none.

    Parameters
    ----------
    tau, q : (m,)
        Torque and position of a joint.
    """
    zero, size = tau == 0.0, np.abs(tau)
    if not zero.any() or zero.all():
        return 0.0
    threshold = float(size[~zero].min())
    near = size[(size >= threshold) & (size < 2.0 * threshold)]
    gaps = np.diff(np.sort(size[(size >= threshold) & (size <= _WITHIN * threshold)]))
    edges = np.flatnonzero(np.diff(zero))
    beside = np.maximum(size[edges], size[edges + 1])
    speed = np.abs(np.gradient(q))
    is_zone = (
        len(np.unique(near)) >= _FEWEST_LEVELS
        and gaps.max() <= _WIDEST * threshold
        and len(edges) >= _FEWEST_PASSES
        and np.median(beside) < _BESIDE * threshold
        and np.quantile(size[~zero], 0.9) > _FAR * threshold
        # A joint that stands may have no torque at all.
        and np.median(speed[zero]) > 0.1 * np.median(speed[~zero])
    )
    return threshold if is_zone else 0.0


def is_out_of_range(tau: FloatArray, low: FloatArray | float, high: FloatArray | float) -> BoolArray:
    """Tell which torques (m, …) were not measured: beyond low and high, or in the dead zone where low is above high."""
    return np.asarray(np.where(low < high, (tau <= low) | (tau >= high), (tau < low) & (tau > high)))


SLOPE = 0.9
"""Correlation above which one column is taken for the slope of another."""


def smooth_columns(values: FloatArray, width: int) -> FloatArray:
    """Return means over `width` rows, twice, without the ends (m, columns)."""
    return values if width <= 1 else _sum_rows(_sum_rows(values, width), width) / width**2


def _sum_rows(values: FloatArray, width: int) -> FloatArray:
    """Return running sums over `width` rows, in a time that does not depend on the width."""
    total = np.cumsum(np.vstack([np.zeros(values.shape[1]), values]), axis=0)
    return np.asarray(total[width:] - total[:-width])


def _average_by_simpson(values: FloatArray, intervals: int) -> FloatArray:
    """Return means over an even number of intervals between rows, by Simpson's rule."""
    signs = np.where(np.arange(len(values)) % 2, -1.0, 1.0)[:, None]
    first, last = values[:-intervals], values[intervals:]
    alternating = signs[: len(first)] * _sum_rows(signs * values, intervals + 1)
    # Weights 1, 4, 2, … 2, 4, 1: 3 of every row, with 1 less or more in turns, and 1 less at both ends.
    return np.asarray((3.0 * _sum_rows(values, intervals + 1) - alternating - first - last) / (3.0 * intervals))


def fill_gaps(values: FloatArray) -> FloatArray:
    """Return the values with gaps filled by straight lines between the numbers."""
    result = np.array(values, dtype=np.float64)
    rows = np.arange(len(values))
    for column in range(values.shape[1]):
        good = np.isfinite(values[:, column])
        if good.any() and not good.all():
            result[:, column] = np.interp(rows, rows[good], values[good, column])
    return result


def correlate_slopes(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Correlate the slope of every column with every other column.

    Parameters
    ----------
    t : (m,)
        In s.
    values : (m, c)
        Values of all columns.

    Returns
    -------
    correlation, factor : (c, c)
        Of the slope of column i with column j; and column j = factor x slope of column i.
    """
    # A clock may start again with every run of a file: a slope must not reach across that.
    steps = np.diff(t)
    rate = len(t) / max(float(steps[steps > 0].sum()), 1e-9)
    # Smooth over 40 ms: differences of positions from row to row would be mostly noise of the encoder.
    width = max(1, int(rate * 0.04))
    restarts = np.concatenate([[0], np.cumsum(steps < 0)])
    steady = smooth_columns(np.column_stack([t, fill_gaps(values)]), width)
    t, values = steady[:, 0], steady[:, 1:]
    reach = max(1, width)
    step = t[2 * reach :] - t[: -2 * reach]
    span = len(restarts) - len(step)
    one_run = restarts[span:] == restarts[:-span]
    good = one_run & (step > 0) & (step < 20 * max(float(np.median(step)), 1e-12))
    rise = (values[2 * reach :] - values[: -2 * reach])[good] / step[good][:, None]
    # The rise of a position over these rows is the mean of its velocity, which a fast motion's middle is not.
    mean = _average_by_simpson(values, 2 * reach)[good]
    if len(rise) < 16:
        nothing = np.zeros((values.shape[1], values.shape[1]))
        return nothing, nothing
    size = np.sqrt((rise**2).sum(axis=0))
    other = np.sqrt((mean**2).sum(axis=0))
    inner = rise.T @ mean
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = np.nan_to_num(inner / (size[:, None] * other[None, :]))
        factor = np.nan_to_num(inner / (size[:, None] ** 2))
    return np.asarray(correlation), np.asarray(factor)


_NOMINAL = 100.0
"""Hz at which rows without time are differentiated; the rate that follows does not depend on it."""
_ALIKE, _MOST, _ROUNDED = 0.02, 0.75, 0.01
"""Relative difference of rates that are one, share of the columns with a slope that give it, and its error."""
_UNDELAYED = 0.99
"""Correlation that a filtered velocity lacks: a first-order filter of this one takes 2 % off the rate, its square."""
_SLOWEST, _FASTEST = 8.0, 8000.0
"""Hz of the rows: with degrees beside rad/s the rate would be 57 times too low or too high."""


def find_rate_by_slopes(values: FloatArray) -> float:
    """Return the rate of rows in Hz at which columns are the slopes of others; 0 where several columns give none.

    Parameters
    ----------
    values : (m, c)
        Values of all columns, such as positions and velocities of joints; NaN where there is no number.
    """
    # A clock has one slope, which any constant is a multiple of: neither goes up and down.
    steps = np.diff(values, axis=0)
    values = values[:, (steps > 0.0).any(axis=0) & (steps < 0.0).any(axis=0)]
    if values.shape[1] < 2:
        return 0.0
    correlation, factor = correlate_slopes(np.arange(len(values)) / _NOMINAL, values)
    np.fill_diagonal(correlation, 0.0)
    pairs = [(i, j) for i, j in enumerate(correlation.argmax(axis=1)) if correlation[:, j].argmax() == i]
    pairs = [pair for pair in pairs if correlation[pair] > _UNDELAYED]
    rates = np.array([_NOMINAL * factor[pair] for pair in pairs])
    common = float(np.median(rates)) if len(rates) > 1 else 0.0
    if not _SLOWEST < common < _FASTEST or np.mean(np.abs(rates - common) <= _ALIKE * common) < _MOST:
        return 0.0
    # Noise takes a little off a slope; most logs have a period of whole milliseconds.
    usual = 1000.0 / max(1, round(1000.0 / common))
    return float(f"{usual if abs(usual / common - 1.0) < _ROUNDED else common:.4g}")
