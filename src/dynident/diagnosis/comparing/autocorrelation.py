"""Autocorrelation of a residual, and the number of independent samples that it is worth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import fft

from dynident.array_types import FloatArray
from dynident.diagnosis.comparing.repeatability import split_uniform_intervals
from dynident.estimation.uncertainty import NORMAL_95

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

    Parameters
    ----------
    parts : sequence of (m_i,)
        Intervals without gaps, which have a common mean.
    n_lags : int
        Number of lags.

    Returns
    -------
    (n_lags,)
        Values at each lag, 1 at lag 0.
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
