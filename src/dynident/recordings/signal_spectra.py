"""Power spectra of velocity, position noise and torque (Welch), on which cut-offs are chosen; steps of signals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft, special

from dynident.array_types import FloatArray
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
