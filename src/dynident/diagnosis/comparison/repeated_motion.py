"""Find the intervals in which a motion repeats an earlier one, in its own run or in another one (§12.7).

Holds how near two positions must be to count as the same, and how many runs are compared.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from weakref import WeakKeyDictionary

import numpy as np
import scipy
from scipy import fft

from dynident.array_types import BoolArray, FloatArray
from dynident.recordings import Recording
from dynident.recordings.signal_spectra import find_used_runs

_SAME = 0.01
"""Share of a joint's range by which positions may differ and still be the same; real arms repeat to within half."""
_STANDING = 0.02
"""A joint that moves through less than this share of the widest range is judged by the widest."""
# Shortest interval (s), number of lags that are tried, and mean square distance below which motions may be alike.
_SHORTEST = 1.0
_LAGS = 6
_ALIKE = 0.5
# Mean square distance from itself at which a motion has left its place.
_AWAY = 0.1
# Share of a period that has to come again.
_ALMOST_A_PERIOD = 0.75
_DEGREE = 5
# Tracks that are compared with each other, and rate (Hz) and number of rows to which they are thinned.
_MOST_RUNS = 12
_TRACK_RATE = 50.0
_TRACK_ROWS = 200_000


@dataclass(frozen=True, eq=False)
class Track:
    """An interval of a motion without gaps.

    Parameters
    ----------
    t : (m,)
        Times, s, evenly spaced.
    q : (m, n)
        Positions, rad or m.
    first : int
        Number of its first row among the rows that it was cut from.
    """

    t: FloatArray
    q: FloatArray
    first: int = 0

    @property
    def step(self) -> float:
        """Time between rows, s."""
        return float((self.t[-1] - self.t[0]) / (len(self.t) - 1))

    @cached_property
    def curve(self) -> scipy.interpolate.BSpline[np.float64]:
        """Spline of the positions over time."""
        return scipy.interpolate.make_interp_spline(self.t, self.q, _DEGREE)

    @cached_property
    def moving(self) -> BoolArray:
        """Whether any joint moves, (m,)."""
        speed = np.abs(np.gradient(self.q, self.t, axis=0))
        usual = np.sqrt((speed**2).mean(axis=0))
        return np.asarray((speed > 0.2 * usual.max()).any(axis=1))


@dataclass(frozen=True)
class Repeat:
    """An interval of one track where another track goes the same way later.

    Parameters
    ----------
    a : int
        Number of the first track.
    b : int
        Number of the track that repeats it.
    start : float
        Start of the interval in the first track, s.
    end : float
        End of the interval in the first track, s.
    lag : float
        Time from the first pass to the next, s.
    """

    a: int
    b: int
    start: float
    end: float
    lag: float

    @property
    def duration(self) -> float:
        """Length in s."""
        return self.end - self.start


def split_uniform_intervals(t: FloatArray, segment: FloatArray) -> list[tuple[int, int]]:
    """Cut rows where a segment ends or time jumps."""
    if len(t) < 2:
        return [(0, len(t))] if len(t) else []
    usual = float(np.median(np.diff(t)))
    cuts = np.flatnonzero((np.diff(t) > 1.5 * usual) | (np.diff(segment) != 0)) + 1
    borders = [0, *cuts.tolist(), len(t)]
    return list(pairwise(borders))


def split_tracks(t: FloatArray, segment: FloatArray, q: FloatArray) -> tuple[Track, ...]:
    """Cut rows into tracks; those that are too short are left out."""
    return tuple(
        Track(t[first:end], q[first:end], first)
        for first, end in split_uniform_intervals(t, segment)
        if end - first > 2 * _DEGREE and t[end - 1] - t[first] >= _SHORTEST
    )


def load_tracks(recording: Recording) -> tuple[Track, ...]:
    """Return the positions of a recording inside its windows as tracks, thinned to what a motion needs."""
    return tuple(track for own in _load_tracks_by_segment(recording) for track in own)


Repeats = tuple[tuple[Repeat, ...], ...]
"""Repeated intervals of each segment."""

# Found once for each recording, and kept as long as it lives: every gathering of products asks for them.
_periods: WeakKeyDictionary[Recording, Repeats] = WeakKeyDictionary()


def find_periods(recording: Recording) -> Repeats:
    """Find where the motion of each segment is repeated within the segment, once for each recording."""
    if recording not in _periods:
        repeats_by_segment = [find_own_repeats(own) for own in _load_tracks_by_segment(recording)]
        _periods[recording] = tuple(tuple(own for own in repeats if own.a == own.b) for repeats in repeats_by_segment)
    return _periods[recording]


def _load_tracks_by_segment(recording: Recording) -> list[list[Track]]:
    # Some tens of samples a second show how an arm moves; long recordings are thinned further.
    stride = max(1, int(recording.sampling_rate / _TRACK_RATE), -(-recording.n_samples // _TRACK_ROWS))
    tracks_by_segment: list[list[Track]] = [[] for _ in recording.segments]
    for first, length in find_used_runs(recording):
        parts = [rows.q for rows in recording.source.rows(first, length, 65_536)]
        q = np.concatenate(parts)[::stride]
        ((number, segment),) = (
            (k, s) for k, s in enumerate(recording.segments) if s.first_row <= first < s.first_row + s.length
        )
        row = first - segment.first_row + stride * np.arange(len(q), dtype=np.float64)
        tracks_by_segment[number] += split_tracks(segment.start_time + row * recording.period, np.zeros(len(q)), q)
    return tracks_by_segment


def find_own_repeats(own: Sequence[Track]) -> tuple[Repeat, ...]:
    """Find where a motion repeats itself: each interval with its next repetition."""
    if not own:
        return ()
    own = own[:_MOST_RUNS]
    tolerance = _compute_tolerance(own)
    periods = [repeat for k, track in enumerate(own) for repeat in _find_periodic_repeats(track, k, tolerance)]
    if periods:
        return tuple(periods)
    # Runs that are one period each: every one beside the one before it.
    return tuple(
        repeat
        for k in range(len(own) - 1)
        for repeat in _find_best_repeats(own[k], own[k + 1], k, k + 1, tolerance)
        if repeat.duration >= _ALMOST_A_PERIOD * min(_get_duration(own[k]), _get_duration(own[k + 1]))
    )


def find_common_repeats(tried: Sequence[Track], fitted: Sequence[Track]) -> tuple[Repeat, ...]:
    """Find intervals of a motion that another motion has as well, at the lag at which most of it is alike.

    Returns
    -------
    tuple of Repeat
        Intervals of the motion in question; empty where nothing is common.
    """
    if not tried or not fitted or tried[0].q.shape[1] != fitted[0].q.shape[1]:
        return ()
    tolerance = _compute_tolerance(fitted)
    return tuple(
        repeat
        for k, track in enumerate(tried[:_MOST_RUNS])
        for number, other in enumerate(fitted[:_MOST_RUNS])
        for repeat in _find_best_repeats(track, other, k, number, tolerance)
    )


def compute_repeated_share(tried: Sequence[Track], fitted: Sequence[Track]) -> float:
    """Return the share of a motion's moving time (0 to 1) that repeats another motion."""
    if not tried or not fitted or tried[0].q.shape[1] != fitted[0].q.shape[1]:
        return 0.0
    tolerance = _compute_tolerance(fitted)
    moving, repeated = 0, 0
    for track in tried[:_MOST_RUNS]:
        known = np.zeros(len(track.t), dtype=bool)
        for other in fitted[:_MOST_RUNS]:
            # A motion may repeat parts of another at several lags; each row counts once.
            for lag in _find_lags(track, other, tolerance):
                known |= _select_same_rows(track, other, lag, tolerance)
        moving += int(track.moving.sum())
        repeated += int((track.moving & known).sum())
    return repeated / moving if moving else 0.0


def _get_duration(track: Track) -> float:
    return float(track.t[-1] - track.t[0])


def _compute_tolerance(own: Sequence[Track]) -> FloatArray:
    low = np.min([track.q.min(axis=0) for track in own], axis=0)
    high = np.max([track.q.max(axis=0) for track in own], axis=0)
    # A share of its own range would leave a joint that hardly moves no tolerance: its noise would be a difference.
    ranges = np.asarray(high - low)
    return np.asarray(_SAME * np.where(ranges < _STANDING * ranges.max(), ranges.max(), ranges))


def _find_periodic_repeats(track: Track, number: int, tolerance: FloatArray) -> list[Repeat]:
    """Return the repetitions at the shortest lag at which nearly a whole period comes twice."""
    # A slow motion is near itself at any short lag: a period can only begin once it has been somewhere else.
    away = _find_departure_lag(track)
    if away is None:
        return []
    # From the shortest lag on: two periods repeat as well as one.
    for lag in sorted(_find_lags(track, track, tolerance, smallest=away)):
        repeats = _build_repeats(track, _select_same_rows(track, track, lag, tolerance), lag, number, number)
        if any(repeat.duration >= _ALMOST_A_PERIOD * lag for repeat in repeats):
            return repeats
    return []


def _find_best_repeats(a: Track, b: Track, number_a: int, number_b: int, tolerance: FloatArray) -> list[Repeat]:
    """Return the repetitions at the lag at which most is repeated."""
    options = [
        _build_repeats(a, _select_same_rows(a, b, lag, tolerance), lag, number_a, number_b)
        for lag in _find_lags(a, b, tolerance)
    ]
    return max(options, key=lambda repeats: sum(repeat.duration for repeat in repeats), default=[])


def _select_same_rows(a: Track, b: Track, lag: float, tolerance: FloatArray) -> BoolArray:
    """Return (m,): rows of `a` where `b` is `lag` later, in intervals that are long enough and move."""
    close = _select_close_rows(a, b, lag, tolerance)
    for first, last in _yield_runs(close):
        if a.t[last - 1] - a.t[first] < _SHORTEST or not a.moving[first:last].any():
            # Short agreements come about by chance, and a pause is no repetition.
            close[first:last] = False
    return close


def _select_close_rows(a: Track, b: Track, lag: float, tolerance: FloatArray) -> BoolArray:
    later = a.t + lag
    overlapping = (later >= b.t[0]) & (later <= b.t[-1])
    close = np.zeros(len(a.t), dtype=bool)
    close[overlapping] = (np.abs(b.curve(later[overlapping]) - a.q[overlapping]) <= tolerance).all(axis=1)
    return close


def _refine_lag(a: Track, b: Track, lag: float, tolerance: FloatArray) -> float:
    """Refine a lag by the rows that nearly agree, so that other rows do not pull at it."""
    # From coarse to fine: with the narrow tolerance alone a lag that is a little off would have no rows to be refined
    # by.
    for widening in (8.0, 4.0, 2.0, 1.0):
        rows = np.flatnonzero(_select_close_rows(a, b, lag, widening * tolerance))
        if not len(rows):
            continue
        # Gauss-Newton with one unknown: the gap of the positions divided by their speed is an error of time.
        speed = b.curve.derivative()(a.t[rows] + lag) / tolerance
        gap = (b.curve(a.t[rows] + lag) - a.q[rows]) / tolerance
        weight = float((speed * speed).sum())
        lag -= float((speed * gap).sum()) / weight if weight > 0 else 0.0
    return lag


def _build_repeats(a: Track, same: BoolArray, lag: float, number_a: int, number_b: int) -> list[Repeat]:
    return [
        Repeat(number_a, number_b, float(a.t[first]), float(a.t[last - 1]), lag) for first, last in _yield_runs(same)
    ]


def _yield_runs(marked: BoolArray) -> Iterator[tuple[int, int]]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8)))
    return zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _find_departure_lag(track: Track) -> float | None:
    """Return the lag after which the motion has left its place, s; None where it never does."""
    distance = _compute_distances(track.q, track.q)[len(track.t) - 1 :]
    away = np.flatnonzero(distance > _AWAY)
    return float(away[0] * track.step) if len(away) else None


def _find_lags(a: Track, b: Track, tolerance: FloatArray, smallest: float | None = None) -> list[float]:
    """Return lags in s at which the two motions are most alike, best first, from `smallest` on where it is given."""
    step = a.step
    # Both motions on one grid of time, as the distances at all lags need it. Straight lines tell which lags are worth a
    # closer look; the spline, whose package takes long to import, is for that look.
    t_b = np.arange(b.t[0], b.t[-1] + 1e-9, step)
    on_grid = b.q if b is a else np.column_stack([np.interp(t_b, b.t, joint) for joint in b.q.T])
    distance = _compute_distances(a.q, on_grid)
    lags = np.arange(-len(a.t) + 1, len(t_b) if b is not a else len(a.t))
    overlap = np.minimum(len(a.t), len(t_b) - lags) - np.maximum(0, -lags)
    long_enough = overlap[: len(distance)] * step >= max(_SHORTEST, 0.2 * min(_get_duration(a), _get_duration(b)))
    lags = lags[: len(distance)]
    inner = np.zeros(len(distance), dtype=bool)
    inner[1:-1] = (distance[1:-1] < distance[:-2]) & (distance[1:-1] <= distance[2:])
    # A lag is worth a closer look at a minimum of the distance, where enough of both motions overlaps.
    chosen = inner & long_enough & (distance < _ALIKE)
    if smallest is not None:
        chosen &= lags * step >= smallest
    best = sorted(np.flatnonzero(chosen), key=lambda k: distance[k])[:_LAGS]
    start = b.t[0] - a.t[0]
    return [_refine_lag(a, b, float(lags[k] * step + start), tolerance) for k in best]


def _compute_distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return (m_a + m_b - 1,): the mean square distance of two motions at every lag, 1 for unrelated motions.

    Joints count by their own spread in `a`, those that hardly move not at all.
    """
    # Each joint in units of its own motion: a large joint must not hide that a small one goes elsewhere.
    spread = a.std(axis=0)
    moving = spread > _STANDING * spread.max() if spread.max() > 0 else np.zeros(len(spread), dtype=bool)
    if not moving.any():
        return np.ones(len(a) + len(b) - 1)
    centre = a[:, moving].mean(axis=0)
    x, y = (a[:, moving] - centre) / spread[moving], (b[:, moving] - centre) / spread[moving]
    m_a, m_b = len(x), len(y)
    size = fft.next_fast_len(m_a + m_b - 1, real=True)
    # All lags at once: |x - y|² is the sum of two squares, which cumulative sums give, minus twice the
    # cross-correlation.
    product = fft.irfft((np.conj(fft.rfft(x, size, axis=0)) * fft.rfft(y, size, axis=0)).sum(axis=1), size)
    inner = np.concatenate([product[size - m_a + 1 :], product[:m_b]])
    lags = np.arange(-m_a + 1, m_b)
    first, last = np.maximum(0, -lags), np.minimum(m_a, m_b - lags)
    squares = (
        np.concatenate([[0.0], np.cumsum((x**2).sum(axis=1))]),
        np.concatenate([[0.0], np.cumsum((y**2).sum(axis=1))]),
    )
    total = squares[0][last] - squares[0][first] + squares[1][last + lags] - squares[1][first + lags]
    return np.asarray((total - 2 * inner) / (2.0 * moving.sum() * np.maximum(last - first, 1)))
