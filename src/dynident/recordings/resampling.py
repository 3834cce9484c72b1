"""Resample jittering samples onto a uniform grid, in a stream."""

from __future__ import annotations

from math import floor

import numpy as np

from dynident.arrays import FloatArray, IntArray

SNAP = 1e-6
"""A grid point so near to a sample (in periods) takes the sample as it is."""

TOO_CLOSE = 0.25
"""Samples nearer to each other than so many periods are not put under one cubic: their noise would swing it."""


class Resampler:
    """Interpolates one gap-free stretch of samples at t0, t0 + T, t0 + 2 T, …; block borders leave no trace.

    t0 is the time of the first sample, plus `lead` in s.

    Cubic (Lagrange, through the two samples on either side): a straight line would leave an error of h² q̈ / 8 in q,
    for steps of 10 ms and 5 rad/s² as large as 6e-5 rad and as rough as the jitter itself, which two differentiations
    bring to the front. Torque goes the same way, so that both are treated alike. A sample that lies on the grid is
    kept unchanged.
    """

    def __init__(self, period: float, lead: float = 0.0) -> None:
        self._period = period
        self._lead = lead
        self._t = np.empty(0)
        self._values = np.empty((0, 0))
        self._start = 0.0
        self._n_given = 0
        self._started = False

    def push(self, t: FloatArray, values: FloatArray) -> FloatArray:
        """Take samples at increasing times t (m,), values (m, c); return the grid rows that are now settled."""
        if not self._started:
            self._start, self._started = float(t[0]) + self._lead, True
            self._t, self._values = t, values
        else:
            self._t, self._values = np.concatenate([self._t, t]), np.concatenate([self._values, values])
        if len(self._t) < 4:
            return self._values[:0]
        # Settled: before the last but one sample, so that two samples stand on either side.
        count = floor((self._t[-2] - self._start) / self._period - SNAP) + 1 - self._n_given
        rows = self._interpolate_rows(count)
        # The next grid row needs two samples before it: earlier ones are forgotten.
        keep = max(0, int(np.searchsorted(self._t, self._compute_next_time(), side="right")) - 3)
        self._t, self._values = self._t[keep:], self._values[keep:]
        return rows

    def finish(self) -> FloatArray:
        """End the stretch; return the grid rows up to its last sample."""
        # A hundredth of a period: rounding must not cost the last row.
        count = floor((self._t[-1] - self._start) / self._period + 0.01) + 1 - self._n_given
        return self._interpolate_rows(count)

    def _compute_next_time(self) -> float:
        return self._start + self._n_given * self._period

    def _interpolate_rows(self, count: int) -> FloatArray:
        if count <= 0:
            return self._values[:0]
        times = self._start + (self._n_given + np.arange(count, dtype=np.float64)) * self._period
        self._n_given += count
        return interpolate_samples(self._t, self._values, times, self._period)


class ShiftedResampler:
    """Resamples a stretch whose torque (columns n to 2 n) is read `delay` s later than the rest of a row."""

    def __init__(self, period: float, n: int, delay: float) -> None:
        self._n = n
        self._delay = delay
        self._rest = Resampler(period, max(0.0, -delay))
        self._torque = Resampler(period, max(0.0, delay))
        self._waiting_rest = np.empty((0, 0))
        self._waiting_torque = np.empty((0, n))

    @property
    def lead(self) -> float:
        """Seconds from the first sample to the first row."""
        return max(0.0, -self._delay)

    def push(self, t: FloatArray, values: FloatArray) -> FloatArray:
        """Take samples; return the rows of which all parts are settled."""
        torque = values[:, self._n : 2 * self._n]
        others = np.delete(values, np.s_[self._n : 2 * self._n], axis=1)
        return self._join_parts(self._rest.push(t, others), self._torque.push(t, torque))

    def finish(self) -> FloatArray:
        """End the stretch; return the rows that have all their parts."""
        return self._join_parts(self._rest.finish(), self._torque.finish())

    def _join_parts(self, others: FloatArray, torque: FloatArray) -> FloatArray:
        """Return the rows that both parts have reached; what is ahead waits."""
        if len(self._waiting_rest):
            others = np.concatenate([self._waiting_rest, others])
        if len(self._waiting_torque):
            torque = np.concatenate([self._waiting_torque, torque])
        count = min(len(others), len(torque))
        self._waiting_rest, self._waiting_torque = others[count:], torque[count:]
        return np.concatenate([others[:count, : self._n], torque[:count], others[:count, self._n :]], axis=1)


def interpolate_samples(t: FloatArray, values: FloatArray, times: FloatArray, period: float) -> FloatArray:
    """Interpolate by cubics through two samples on either side, or by straight lines where samples are too close.

    Parameters
    ----------
    t : (m,)
    values : (m, c)
    times : (k,)
        Where to interpolate.
    period : float
        Usual step of t in s.

    Returns
    -------
    (k, c)
    """
    m = len(t)
    if m == 1:
        return np.repeat(values, len(times), axis=0)
    right = np.clip(np.searchsorted(t, times, side="left"), 1, m - 1)
    nearest = np.where(times - t[right - 1] < t[right] - times, right - 1, right)
    on_grid = np.abs(t[nearest] - times) <= SNAP * period
    # Samples of an even clock are on the grid as they are: nothing is computed, and no digit changes.
    if on_grid.all():
        lowest = int(nearest[0])
        if np.array_equal(nearest, np.arange(lowest, lowest + len(nearest))):
            return values[lowest : lowest + len(nearest)]
        return values[nearest]
    result = _interpolate_linear(t, values, times, right)
    if m >= 4:
        first = np.clip(right - 2, 0, m - 4)
        spread = np.diff(t)
        tight = spread < TOO_CLOSE * period
        cubic = ~(tight[first] | tight[first + 1] | tight[first + 2]) & ~on_grid
        result[cubic] = _interpolate_cubic(t, values, times[cubic], first[cubic])
    result[on_grid] = values[nearest[on_grid]]
    return result


def _interpolate_linear(t: FloatArray, values: FloatArray, times: FloatArray, right: IntArray) -> FloatArray:
    """Interpolate by straight lines; `right` is the index of the sample behind each time."""
    share = ((times - t[right - 1]) / (t[right] - t[right - 1]))[:, None]
    result: FloatArray = (1.0 - share) * values[right - 1] + share * values[right]
    return result


def _interpolate_cubic(t: FloatArray, values: FloatArray, times: FloatArray, first: IntArray) -> FloatArray:
    """Evaluate the cubic through samples first … first + 3 by Lagrange's weights."""
    knots = t[first[:, None] + np.arange(4)]
    result = np.zeros((len(times), values.shape[1]))
    for index in range(4):
        weight = np.ones(len(times))
        for other in range(4):
            if other != index:
                weight *= (times - knots[:, other]) / (knots[:, index] - knots[:, other])
        result += weight[:, None] * values[first + index]
    return result
