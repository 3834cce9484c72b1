"""The parallel filter of §12.4: low-pass and decimate columns of W and Y alike; stop band 50 dB."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from math import ceil, pi, prod
from typing import NamedTuple

import numpy as np
from scipy import special

from dynident.array_types import BoolArray, FloatArray
from dynident.parallel import prefetch
from dynident.recordings.position_filter import filtered_blocks
from dynident.recordings.preprocessing import Preprocessing
from dynident.recordings.recording import Recording, SampleBlock

ATTENUATION = 50.0
"""Attenuation of the stop band in dB: what folds back under the cut-off by decimation is below 0.3 % of itself."""


_NUMBERS_AT_ONCE, _LEAST_AT_ONCE = 1 << 22, 256
"""Numbers that are evaluated at once, 32 MB, and the fewest samples: robots on their feet have 40,000 columns."""


class FilteredRows(NamedTuple):
    """Rows that are left after filtering and decimation.

    Parameters
    ----------
    values : (r, …)
        Filtered values of the rows.
    t : (r,)
        Their times in s.
    used : (r,) of bool
        True where every row under the filter was used.
    """

    values: FloatArray
    t: FloatArray
    used: BoolArray


def low_pass(rate: float, cutoff: float | None) -> FloatArray:
    """Return the taps of the linear-phase low-pass: a windowed sinc (Kaiser), unit gain at zero frequency.

    The transition band reaches from half to one and a half times the cut-off (narrower near the Nyquist frequency);
    the taps are symmetric, so that reading the output h samples earlier leaves no phase lag.

    Parameters
    ----------
    rate : float
        Sampling rate in Hz.
    cutoff : float or None
        Cut-off frequency in Hz; None: one tap.

    Returns
    -------
    (2 h + 1,)
        The taps, symmetric, with the sum 1.
    """
    if cutoff is None:
        return np.ones(1)
    # A cut-off near the Nyquist frequency leaves less room for the transition.
    half_width = min(0.5 * cutoff, 0.9 * (0.5 * rate - cutoff))
    width = 2.0 * half_width / (0.5 * rate)
    # Kaiser's formula for the length that gives this attenuation outside this transition band.
    half = max(1, ceil((ATTENUATION - 7.95) / (2.285 * pi * width) / 2.0))
    taps = _design_windowed_sinc(half, cutoff / (0.5 * rate))
    # Exactly symmetric: rounding must not give the filter a phase.
    return 0.5 * (taps + taps[::-1])


def correlate_white_noise(rate: float, cutoff: float | None) -> FloatArray:
    """Return the autocorrelation of white noise behind the low-pass, for lags of -2 h to 2 h samples.

    Parameters
    ----------
    rate, cutoff : float, float or None
        As `low_pass` takes them, whose taps are 2 h + 1.

    Returns
    -------
    (4 h + 1,)
        The autocorrelation; 1 at the lag of zero, in the middle.
    """
    taps = low_pass(rate, cutoff)
    return np.asarray(np.correlate(taps, taps, "full") / float(taps @ taps))


def _design_windowed_sinc(half: int, edge: float) -> FloatArray:
    """Return a low-pass of 2 half + 1 taps with its edge at a share of the Nyquist frequency (scipy.signal.firwin)."""
    # Kaiser's formula for the window that gives this attenuation.
    beta = 0.5842 * (ATTENUATION - 21.0) ** 0.4 + 0.07886 * (ATTENUATION - 21.0)
    k = np.arange(-half, half + 1, dtype=np.float64)
    window = special.i0(beta * np.sqrt(1.0 - (k / half) ** 2)) / special.i0(beta)
    taps = edge * np.sinc(edge * k) * window
    return np.asarray(taps / taps.sum(), dtype=np.float64)


class ParallelFilter:
    """Low-pass and decimate rows that arrive in blocks; the blocks' borders leave no trace.

    The filter is a symmetric FIR low-pass read without delay: the output of row k is centred on row k. Output rows
    are rows 0, d, 2d, … of a segment as far as the filter's window lies inside the segment; the others do not exist.
    A row is `used` if all rows under the filter's window are. Nothing is filtered across segments.

    Outputs are computed in fixed tiles of a few rows, each as one product of a banded matrix with the rows under it,
    so that the result does not depend on how the rows were cut into blocks.

    Parameters
    ----------
    rate : float
        Sampling rate in Hz.
    cutoff : float or None
        Cut-off frequency in Hz; None: no filter, decimation alone.
    decimation : int
        Every how many-th row to give.
    """

    def __init__(self, rate: float, cutoff: float | None, decimation: int = 1) -> None:
        if decimation < 1:
            raise ValueError(f"decimation is {decimation}; it must be at least 1")
        self.taps = low_pass(rate, cutoff)
        self.decimation = decimation
        self.half = len(self.taps) // 2
        # Output rows are multiples of d; the first whose window fits starts at row `_offset` of the segment.
        self._offset = -self.half % decimation
        self._tile = _choose_tile_length(len(self.taps), decimation)
        self._band = _build_band_matrix(self.taps, decimation, self._tile)
        self._rows: FloatArray | None = None
        self._t = np.empty(0)
        self._used = np.empty(0, dtype=bool)
        self._skip = self._offset
        self._shape: tuple[int, ...] = ()

    @property
    def span(self) -> int:
        """Rows under the filter's window, 2 h + 1."""
        return len(self.taps)

    def push(self, values: FloatArray, t: FloatArray, used: BoolArray, starts_segment: bool = False) -> FilteredRows:
        """Take the next rows and return the output rows that are now complete.

        Parameters
        ----------
        values : (m, …)
            Rows to filter, all their columns alike.
        t : (m,)
            Times in s.
        used : (m,) of bool
            Which rows lie inside the windows, clear of the segment's ends.
        starts_segment : bool
            Whether the first row begins a new segment: what is left of the previous one comes first in the answer. Call
            `flush` before it to have the two apart.

        Returns
        -------
        FilteredRows
            The output rows that no later row can change.
        """
        if not (len(values) == len(t) == len(used)):
            raise ValueError(f"{len(values)} rows of values, {len(t)} times, {len(used)} marks: the numbers must agree")
        remaining = self.flush() if starts_segment and self._rows is not None else None
        self._shape = values.shape[1:]
        rows = np.ascontiguousarray(values, dtype=np.float64).reshape(len(values), prod(self._shape))
        filtered = self._advance(rows, t, used)
        if remaining is None or not len(remaining.t):
            return filtered
        return FilteredRows(*(np.concatenate(pair) for pair in zip(remaining, filtered, strict=True)))

    def flush(self) -> FilteredRows:
        """End the segment; return its output rows whose window lies inside it and that are still due."""
        rows, t, used = self._rows, self._t, self._used
        self._rows, self._t, self._used, self._skip = None, np.empty(0), np.empty(0, dtype=bool), self._offset
        if rows is None or len(rows) < self.span:
            width = 0 if rows is None else rows.shape[1]
            return self._make_rows(np.empty((0, width)), np.empty(0), np.empty(0, dtype=bool))
        count = (len(rows) - self.span) // self.decimation + 1
        reach = (count - 1) * self.decimation + self.span
        values = self._band[:count, :reach] @ rows[:reach]
        return self._make_rows(values, *self._mark_used(t, used, count))

    def _advance(self, rows: FloatArray, t: FloatArray, used: BoolArray) -> FilteredRows:
        if self._skip:
            dropped = min(self._skip, len(rows))
            self._skip -= dropped
            rows, t, used = rows[dropped:], t[dropped:], used[dropped:]
        if self._rows is None:
            self._rows = np.empty((0, rows.shape[1]))
        step = self._tile * self.decimation
        reach = self._band.shape[1]
        n_kept = len(self._rows)
        n_all = n_kept + len(rows)
        # Whole tiles only: how rows are cut into blocks changes no output.
        n_tiles = max(0, (n_all - reach) // step + 1)
        # Tiles that begin among the rows kept from earlier blocks; all others lie in the new rows, read in place.
        n_border = min(n_tiles, ceil(n_kept / step))
        values = np.empty((n_tiles * self._tile, rows.shape[1]))
        if n_border:
            needed = (n_border - 1) * step + reach
            border = np.concatenate([self._rows, rows[: max(0, needed - n_kept)]])
            self._multiply(border, n_border, values[: n_border * self._tile])
        if n_tiles > n_border:
            self._multiply(rows[n_border * step - n_kept :], n_tiles - n_border, values[n_border * self._tile :])
        all_t = np.concatenate([self._t, t])
        all_used = np.concatenate([self._used, used])
        out_t, out_used = self._mark_used(all_t, all_used, n_tiles * self._tile)
        n_consumed = n_tiles * step
        if n_consumed >= n_kept:
            self._rows = rows[n_consumed - n_kept :].copy()
        else:
            self._rows = np.concatenate([self._rows[n_consumed:], rows])
        self._t, self._used = all_t[n_consumed:], all_used[n_consumed:]
        # Decimation by more than the window's span: rows that no window covers are yet to come.
        self._skip += max(0, n_consumed - n_all)
        return self._make_rows(values, out_t, out_used)

    def _multiply(self, rows: FloatArray, n_tiles: int, out: FloatArray) -> None:
        """Fill `out` (n_tiles tile, k): one product for each tile, its rows read in place."""
        step, (tile, reach), width = self._tile * self.decimation, self._band.shape, rows.shape[1]
        row, item = rows.strides
        # Tiles overlap by the filter's window: strides let them share the rows without copies.
        tiles = np.lib.stride_tricks.as_strided(
            rows, shape=(n_tiles, reach, width), strides=(step * row, row, item), writeable=False
        )
        np.matmul(self._band, tiles, out=out.reshape(n_tiles, tile, width))

    def _mark_used(self, t: FloatArray, used: BoolArray, count: int) -> tuple[FloatArray, BoolArray]:
        if not count:
            return np.empty(0), np.empty(0, dtype=bool)
        first = np.arange(count) * self.decimation
        # Used rows under each window, by differences of the running count.
        before = np.concatenate([[0], np.cumsum(used)])
        complete: BoolArray = before[first + self.span] - before[first] == self.span
        return t[first + self.half], complete

    def _make_rows(self, values: FloatArray, t: FloatArray, used: BoolArray) -> FilteredRows:
        return FilteredRows(values.reshape(len(t), *self._shape), t, used)


def _choose_tile_length(n_taps: int, decimation: int) -> int:
    """Return the output rows of a tile: enough for an efficient matrix product, few enough to have few zeros."""
    return int(np.clip(round(0.5 * n_taps / decimation), 4, 64))


def _build_band_matrix(taps: FloatArray, decimation: int, tile: int) -> FloatArray:
    """Return the matrix (tile, (tile - 1) d + span) whose row i holds the taps from column i d on."""
    band = np.zeros((tile, (tile - 1) * decimation + len(taps)))
    for index in range(tile):
        band[index, index * decimation : index * decimation + len(taps)] = taps
    return band


_BlockFunction = Callable[[SampleBlock], FloatArray]


def filter_in_parallel(
    recording: Recording,
    preprocessing: Preprocessing,
    values: _BlockFunction,
    segments: Sequence[int] | None = None,
    width: int = 1,
) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Stream `values` of every block through the parallel filter.

    Parameters
    ----------
    recording : Recording
    preprocessing : Preprocessing
    values : function
        Gives (m, k) of a block of filtered positions.
    segments : sequence of int, optional
        Which segments, by index; all by default.
    width : int
        Number of columns k, where it may be large: of many columns fewer samples are evaluated at once.

    Yields
    ------
    segment, t (m,), rows (m, k)
        Used rows alone; none where a recording under way has no more for now.
    """
    return low_pass_samples(stream_samples(recording, preprocessing, values, segments, width), recording, preprocessing)


@dataclass(frozen=True, eq=False)
class Samples:
    """Consecutive rows of one segment at the full rate.

    Parameters
    ----------
    segment : int
        Number of the segment.
    starts_segment : bool
        Whether these are the first rows of the segment.
    t : (m,)
        Times, s.
    used : (m,)
        Which of the rows count.
    values : (m, k)
        Whatever is filtered: entries of W, or of a form, with Y.
    """

    segment: int
    starts_segment: bool
    t: FloatArray
    used: BoolArray
    values: FloatArray


def stream_samples(
    recording: Recording,
    preprocessing: Preprocessing,
    values: _BlockFunction,
    segments: Sequence[int] | None = None,
    width: int = 1,
) -> Iterator[Samples]:
    """Stream `values` of every block of filtered positions; of a large recording the next block is prepared ahead.

    The acceleration may pass a wider filter than the positions (`Preprocessing.find_acceleration_cutoff`), because what
    theirs takes away of it would make inertias too large. The columns of inertias are linear in the acceleration, so
    that the parallel filter takes its noise away again. Columns with the magnitude of a load keep a part of it.

    Parameters
    ----------
    recording : Recording
    preprocessing : Preprocessing
    values : function
        Gives (m, k) of a block of filtered positions.
    segments : sequence of int, optional
        Which segments, by index; all by default.
    width : int
        Number of columns k, where it may be large: of many columns fewer samples are evaluated at once.

    Yields
    ------
    Samples
        Empty where a recording under way has no more for now.
    """
    wide = preprocessing.find_acceleration_cutoff(recording.sampling_rate)
    samples = (
        Samples(
            block.segment,
            block.starts_segment,
            block.t,
            block.used,
            values(block) if len(block.t) else np.empty((0, 0)),
        )
        for whole in filtered_blocks(recording, preprocessing, segments=segments, acceleration_cutoff=wide)
        for block in whole.split(max(_LEAST_AT_ONCE, _NUMBERS_AT_ONCE // max(width, 1)))
    )
    return prefetch(samples, recording.n_samples)


def low_pass_samples(
    samples: Iterable[Samples], recording: Recording, preprocessing: Preprocessing
) -> Iterator[tuple[int, FloatArray, FloatArray]]:
    """Stream samples through the parallel filter; only rows that are used come out.

    Parameters
    ----------
    samples : iterable of Samples
        Consecutive rows at the full rate.
    recording : Recording
        The recording that the samples are of.
    preprocessing : Preprocessing
        Cut-off of the parallel filter, and decimation.

    Yields
    ------
    segment, t (m,), rows (m, k)
        Decimated rows of one segment.
    """
    low_pass = ParallelFilter(recording.sampling_rate, preprocessing.torque_cutoff, preprocessing.decimation)
    segment = -1
    for part in samples:
        if not len(part.t):
            yield part.segment, part.t, part.values
            continue
        # Flushed here, so that the rows that are left of a segment come out under its own number.
        if part.starts_segment and segment >= 0:
            remaining = low_pass.flush()
            if remaining.used.any():
                yield segment, remaining.t[remaining.used], remaining.values[remaining.used]
        segment = part.segment
        filtered = low_pass.push(part.values, part.t, part.used, part.starts_segment)
        if filtered.used.any():
            yield segment, filtered.t[filtered.used], filtered.values[filtered.used]
    remaining = low_pass.flush()
    if remaining.used.any():
        yield segment, remaining.t[remaining.used], remaining.values[remaining.used]
