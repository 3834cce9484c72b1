"""Autocorrelation of the residual, and its spectra over time and over a joint's angle, as figures show them.

Holds the longest lag (5 s), the highest frequency over an angle, and when a line of a spectrum is marked.

Spectra over time show vibration; spectra over a joint's own angle show its gears.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy import fft

from dynident.array_types import FloatArray
from dynident.diagnosis.comparison.repeated_motion import split_uniform_intervals
from dynident.errors import DynidentError
from dynident.estimation.parameter_covariance import NORMAL_95

LONGEST = 5.0
"""Seconds up to which the autocorrelation is given where nobody says how far."""


@dataclass(frozen=True, eq=False)
class Autocorrelation:
    """Autocorrelation of a residual over the lag.

    Parameters
    ----------
    lag : (k,)
        Lags from 0 on, s.
    value : (k,)
        Autocorrelation at each lag; 1 at lag 0.
    limit : float
        Half-width of the 95 % band that the values of independent samples would keep to.
    n_samples : int
        Number of samples of the residual.
    effective_samples : float
        Number of independent samples that these are worth for a mean.
    """

    lag: FloatArray
    value: FloatArray
    limit: float
    n_samples: int
    effective_samples: float


def autocorrelation(
    t: FloatArray, segment: FloatArray, residual: FloatArray, longest: float = LONGEST
) -> Autocorrelation:
    """Compute the autocorrelation of one joint's residual (m,) over its intervals without gaps.

    Parameters
    ----------
    t, segment : (m,)
        Times, s, and numbers of the segments; no product reaches across a gap.
    residual : (m,)
        Residual of one joint, N m or N.
    longest : float
        Longest lag, s.

    Returns
    -------
    Autocorrelation
        The autocorrelation up to the longest lag.
    """
    runs = split_uniform_intervals(t, segment)
    parts = [residual[first:last] for first, last in runs]
    most = max((last - first for first, last in runs), default=1)
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    # All lags: the residual may remember longer than what is shown.
    all_lags = correlate_intervals(parts, most)
    values = all_lags[: min(most, int(longest / step) + 1)]
    return Autocorrelation(
        lag=step * np.arange(len(values), dtype=np.float64),
        value=values,
        # The autocorrelation of m independent samples has the standard deviation 1 / √m at every lag.
        limit=NORMAL_95 / float(np.sqrt(max(len(residual), 1))),
        n_samples=len(residual),
        effective_samples=_count_effective_samples(all_lags, len(residual)),
    )


def correlate_intervals(parts: Sequence[FloatArray], n_lags: int) -> FloatArray:
    """Return the autocorrelation of intervals at lags of 0, 1, … samples.

    Of the two usual divisors the one that keeps it positive semidefinite: the number of samples, not of products.
    """
    mean = float(np.concatenate(parts).mean()) if parts else 0.0
    sums = np.zeros(n_lags)
    for part in parts:
        # Padding with as many zeros keeps the end of the interval from being multiplied with its beginning.
        size = fft.next_fast_len(2 * len(part), real=True)
        power = np.abs(fft.rfft(part - mean, size)) ** 2
        products: FloatArray = fft.irfft(power, size)[: min(n_lags, len(part))]
        sums[: len(products)] += products
    # A residual of zeros has no memory: 1 at lag 0, zero elsewhere.
    if not sums[0] > 0:
        return np.asarray(np.eye(1, n_lags)[0])
    return np.asarray(sums / sums[0])


def count_independent_squares(parts: Sequence[FloatArray]) -> float:
    """Return how many independent samples the mean square of these intervals (m_i,) is worth: m / Σ ρ²."""
    count = sum(len(part) for part in parts)
    if count == 0:
        return 0.0
    autocorrelations = correlate_intervals(parts, max(len(part) for part in parts))
    end = _find_end_of_memory(autocorrelations)
    return count / (1.0 + 2.0 * float((autocorrelations[1:end] ** 2).sum()))


def _count_effective_samples(autocorrelations: FloatArray, count: int) -> float:
    """Return m / (1 + 2 Σ ρ), at most m: a residual that alternates is not worth more than its number of samples."""
    end = _find_end_of_memory(autocorrelations)
    return float(min(count, count / max(1.0 + 2.0 * float(autocorrelations[1:end].sum()), 1e-9)))


def _find_end_of_memory(autocorrelations: FloatArray) -> int:
    """Return the first lag where two neighbours sum to less than zero: beyond it there is only noise (Geyer 1992)."""
    # Sums of neighbours are positive and fall for a stationary process; noise alone turns them negative.
    pairs = autocorrelations[: len(autocorrelations) // 2 * 2].reshape(-1, 2).sum(axis=1)
    negative = np.flatnonzero(pairs <= 0)
    return int(2 * negative[0]) if len(negative) else len(autocorrelations)


Over = Literal["time", "angle"]

HIGHEST_IN_A_RADIAN = 250.0 / (2.0 * np.pi)
HIGHEST_IN_A_METRE = 250.0
"""Highest number of cycles that is looked for."""
# Longest and shortest segment of Welch's method, in rows.
_LONGEST = 2048
_SHORTEST = 16
# Bins of a joint's range for each cycle of the highest frequency, factor of zero padding, and cycles that the range has
# to hold.
_BINS_A_CYCLE = 16
_PADDING = 2
_LEAST_CYCLES = 8.0
# The highest of a few hundred values of noise is three times their median.
_LINE = 4.5


@dataclass(frozen=True, eq=False)
class ResidualSpectrum:
    """Amplitude spectrum of one joint's residual.

    Parameters
    ----------
    over : Over
        What the residual is a function of: time, or the joint's own angle.
    frequency : (k,)
        Frequencies: Hz, or cycles a radian or metre.
    amplitude : (k,)
        Amplitudes, N m or N: a sine of amplitude A is a peak of height A.
    resolution : float
        Width of such a peak, in the unit of the frequency.
    """

    over: Over
    frequency: FloatArray
    amplitude: FloatArray
    resolution: float

    def list_highest_peaks(self, most: int = 5) -> tuple[int, ...]:
        """Return the indices of the highest peaks, highest first."""
        # Importing it takes half a second, so that only those who need it do.
        from scipy import signal

        indices, _ = signal.find_peaks(self.amplitude)
        return tuple(int(k) for k in sorted(indices, key=lambda k: -self.amplitude[k])[:most])

    def is_line(self, k: int) -> bool:
        """Return whether the value at an index is a line above its surroundings, and not mere noise."""
        reach = max(8, len(self.amplitude) // 10)
        around = self.amplitude[max(0, k - reach) : k + reach + 1]
        return bool(self.amplitude[k] > _LINE * np.median(around))


def time_spectrum(t: FloatArray, segment: FloatArray, residual: FloatArray) -> ResidualSpectrum:
    """Compute the amplitude spectrum of one joint's residual over time, by Welch's method.

    Parameters
    ----------
    t, segment, residual : (m,)
        Times, s, numbers of the segments, and residual of the joint, N m or N.

    Returns
    -------
    ResidualSpectrum
        The spectrum over frequencies in Hz.

    Raises
    ------
    DynidentError
        Where no interval without gaps is long enough.
    """
    # Importing it takes half a second, so that only those who need it do.
    from scipy import signal

    runs = [(first, last) for first, last in split_uniform_intervals(t, segment) if last - first >= _SHORTEST]
    if not runs:
        raise DynidentError(
            f"no segment has {_SHORTEST} rows; use a longer recording or wider windows",
            pointer="over",
            title="Too few samples",
        )
    lengths = np.sort([last - first for first, last in runs])[::-1]
    # So long that half of the rows lie in runs which are as long.
    length = int(min(_LONGEST, lengths[np.searchsorted(np.cumsum(lengths), 0.5 * lengths.sum())]))
    step = float(np.median(np.diff(t)))
    power, weight = np.zeros(length // 2 + 1), 0.0
    for first, last in runs:
        if last - first >= length:
            _, here = signal.welch(
                residual[first:last], 1.0 / step, "hann", length, detrend="constant", scaling="spectrum"
            )
            power, weight = power + (last - first) * here, weight + last - first
    frequency = fft.rfftfreq(length, step)
    # The power of a sine is half the square of its amplitude.
    return ResidualSpectrum("time", frequency, np.sqrt(2.0 * power / weight), 2.0 / (length * step))


def angle_spectrum(
    q: FloatArray, dq: FloatArray, residual: FloatArray, highest: float = HIGHEST_IN_A_RADIAN
) -> ResidualSpectrum:
    """Compute the amplitude spectrum of one joint's residual over its own position.

    Rows count by the joint's speed, so that every piece of the way counts alike, however long the joint stayed on it.
    What passed the low-pass filter in part only, since the joint was fast, is shown as small as it is.

    Parameters
    ----------
    q, dq, residual : (m,)
        Positions and velocities (rad or m and a second), and residual of the joint, N m or N.
    highest : float
        Highest frequency given, in cycles a radian (a metre).

    Returns
    -------
    ResidualSpectrum
        The spectrum over cycles a radian or metre.

    Raises
    ------
    DynidentError
        Where the joint hardly moves.
    """
    low, high = (float(value) for value in np.quantile(q, [0.001, 0.999])) if len(q) else (0.0, 0.0)
    span = high - low
    least = _LEAST_CYCLES / highest
    if not span > least:
        raise DynidentError(
            f"the joint moves through only {span:.3g}: give a recording in which it moves through more than "
            f"{least:.2g}",
            pointer="joint",
            title="Too little motion",
        )
    n_bins = int(np.ceil(_BINS_A_CYCLE * highest * span))
    place = np.clip(((q - low) / span * n_bins).astype(np.intp), 0, n_bins - 1)
    # A window over the range of the joint keeps its ends from making lines of their own.
    taper = np.sin(np.pi * (place + 0.5) / n_bins) ** 2 * np.abs(dq)
    weight = float(taper.sum())
    # Without its weighted mean the residual has no peak at zero that would hide slow waves.
    centred = residual - (float(taper @ residual) / weight if weight > 0 else 0.0)
    sums = np.bincount(place, weights=taper * centred, minlength=n_bins)
    size = fft.next_fast_len(_PADDING * n_bins, real=True)
    frequency = fft.rfftfreq(size, span / n_bins)
    in_range = (frequency >= 1.0 / span) & (frequency <= highest)
    # A real wave has half of its amplitude at the negative frequency.
    amplitude = 2.0 * np.abs(fft.rfft(sums, size)) / max(weight, np.finfo(float).tiny)
    return ResidualSpectrum("angle", frequency[in_range], amplitude[in_range], 2.0 / span)
