"""Decide for each joint when it moves, reverses or stands still, from raw positions.

Holds the speeds and travels that count as standstill.

Dry friction has a sign only while a joint moves. Where it stands or sticks, its torque is whatever holds it, anything
up to its static friction, and `Fc sign(q̇)` says nothing. Where it turns round without sticking, the sign changes
within what the filters smear: only friction that remembers the path (presliding) says how.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from enum import IntEnum
from math import ceil
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import BoolArray, FloatArray, IntArray
from dynident.recordings.pose_recordings import has_poses
from dynident.recordings.position_filter import READ_LENGTH
from dynident.recordings.preprocessing import Preprocessing
from dynident.recordings.recording import Recording
from dynident.recordings.signal_spectra import is_out_of_range

SLOW = 0.01
"""Speed in rad/s or m/s below which a joint may as well stand: half and four times as much change little
(`benchmarks/standing_rows.py`), since a joint passes it within milliseconds unless it sticks."""

SLOW_SHARE = 0.05
"""The same as a share of the joint's own rms speed, for joints that are meant to move slowly."""

STANDS = 2e-3
"""Travel in rad or m that noise and a controller's play leave a joint that is not meant to move."""

_DEVIATIONS = 3.0
"""Standard deviations of the position's resolution, over the time that a speed is taken from, below the slow speed."""

_SHORTEST_STEP, _LONGEST_STEP = 8e-3, 0.1
"""Seconds that a speed is taken over at least, lest positions that are held or interpolated between two readings jerk
it, and at most, however coarse they are."""

_SLOWLY = 2.0
"""Times the slow speed that a halt begins and ends at: noise about one threshold would cut it into many."""

FASTER = 5.0
"""Times the slow speed that a joint which turns freely comes from and goes to; in between its acceleration lasts."""

_LINGERS = 1.5
"""It sticks if it stays so many times longer than it would turning freely, at the larger of its accelerations before
and behind. Of sticks that are most of a halt hardly one is then called free, of those that are short beside the turn a
third (`benchmarks/standing_rows.py`): nobody can tell them from a turn."""

_UNTOLD = 0.2
"""Share of its rms speed that a joint's speed is uncertain by, from where on nobody can tell when it stands."""

_SURVEYED = 16384
"""Samples that the resolution of the positions is told from."""

_COUNTED = 1 << 16
"""Samples that are counted at once: their times and phases, all together, would take 40 bytes a sample and more."""

_SELDOM = 0.1
"""Share of its turns at which a joint that turns freely may seem to stick."""

_SAMPLES = 2
"""Samples by which a time between two speeds is uncertain."""


class Phase(IntEnum):
    """What a joint does at a row."""

    MOVING = 0
    REVERSING = 1
    STANDING = 2
    PASSIVE_HALT = 3
    """It moves, but a joint with friction that follows it turns round or stands."""
    NO_TORQUE = 4
    """Its torque was not recorded, or stands at its range: whatever it does, its own equation says nothing."""


PhaseArray = NDArray[np.int8]


@dataclass(frozen=True, eq=False)
class Halts:
    """When one joint is slow in one segment: from `starts` to `ends` (k,) in s, and where it `sticks` (k,).

    `turns` (k,): it comes from one side and leaves to the other, at speed, whether it sticks between or not.
    """

    starts: FloatArray
    ends: FloatArray
    sticks: BoolArray
    turns: BoolArray

    def is_near(self, t: FloatArray, before: float, after: float, chosen: BoolArray) -> BoolArray:
        """Return (m,): which times t (m,) are at most `before` s ahead of, or `after` s behind, a chosen halt."""
        starts, ends = self.starts[chosen] - before, self.ends[chosen] + after
        # Intervals are sorted: a time lies in one if more of them have begun than are over.
        begun = np.searchsorted(starts, t, side="right")
        over = np.searchsorted(ends, t, side="left")
        return np.asarray(begun > over)

    def with_reversals(self, t: FloatArray, width: float) -> Halts:
        """Return the same with reversals where t (m,) is far from any halt; those nearer than two widths are one."""
        t = t[~self.is_near(t, width, width, np.ones(len(self.starts), dtype=bool))]
        if not len(t):
            return self
        gaps = np.diff(t) > 2.0 * width
        starts = np.concatenate([self.starts, t[np.append(True, gaps)]])
        ends = np.concatenate([self.ends, t[np.append(gaps, True)]])
        none = np.zeros(len(starts) - len(self.starts), dtype=bool)
        order = np.argsort(starts)
        both = (np.concatenate([own, none])[order] for own in (self.sticks, self.turns))
        return Halts(starts[order], ends[order], *both)


@dataclass(frozen=True, eq=False)
class Phases:
    """The halts of all joints in every segment of a recording: `halts[segment][joint]`.

    So is `clipped`, the times at which the torque of a joint stands at its range; empty where none does.
    """

    halts: tuple[tuple[Halts, ...], ...]
    clipped: tuple[tuple[Halts, ...], ...] = ()

    @property
    def freely_reversing(self) -> BoolArray:
        """Joints (n,) that turn round without sticking nearly always.

        Where a joint sticks at some of its turns, it may stick unseen, for a moment, at the others.
        """
        turns_freely = []
        for joint in zip(*self.halts, strict=True):
            turns = np.concatenate([halts.turns for halts in joint])
            sticks = np.concatenate([halts.sticks for halts in joint])[turns]
            turns_freely.append(len(sticks) > 0 and float(sticks.mean()) <= _SELDOM)
        return np.array(turns_freely, dtype=bool)

    def phases_at(self, segment: int, t: FloatArray, width: float, after: float = 0.0) -> PhaseArray:
        """Return the phase of every joint at times of a segment.

        Parameters
        ----------
        segment : int
            Index of the segment.
        t : (m,)
            Times in s.
        width : float
            Seconds that a filter smears to either side: rows nearer than that to a halt are part of it.
        after : float
            Seconds that a halt is felt later on top of that, by a filter with a memory.

        Returns
        -------
        (m, n)
            One of `Phase` for every time and joint.
        """
        out = np.zeros((len(t), len(self.halts[segment])), dtype=np.int8)
        for j, halts in enumerate(self.halts[segment]):
            everyone = np.ones(len(halts.starts), dtype=bool)
            # All halts are reversals first; those that stick then count as standstills.
            out[halts.is_near(t, width, width + after, everyone), j] = Phase.REVERSING
            out[halts.is_near(t, width, width + after, halts.sticks), j] = Phase.STANDING
        return out

    def find_clipped(self, segment: int, t: FloatArray, width: float, after: float = 0.0) -> BoolArray:
        """Return (m, n): at which times, as in `phases_at`, the torque of a joint is at its range, and not measured."""
        out = np.zeros((len(t), len(self.halts[segment])), dtype=bool)
        for j, spans in enumerate(self.clipped[segment] if self.clipped else ()):
            out[:, j] = spans.is_near(t, width, width + after, spans.sticks)
        return out


def compute_smear_width(preprocessing: Preprocessing, rate: float) -> float:
    """Return the seconds that the filters smear a halt over, to either side.

    That is 1 / the lower cut-off, or a period without filters.

    Parameters
    ----------
    preprocessing : Preprocessing
        Filters and decimation.
    rate : float
        Sampling rate in Hz.

    Returns
    -------
    float
        Width in s.
    """
    cutoffs = [f for f in (preprocessing.position_cutoff, preprocessing.torque_cutoff) if f is not None]
    # Half a period more, so that rounding does not decide about rows on the border.
    return (1.0 / min(cutoffs) if cutoffs else 1.0 / rate) + 0.5 / rate


@dataclass(frozen=True, eq=False)
class PhaseShares:
    """Shares of every joint's time in which it stands and in which it reverses; in the rest it moves.

    Parameters
    ----------
    standing : (n,)
        Share, from 0 to 1, in which the joint stands or sticks.
    reversing : (n,)
        Share, from 0 to 1, in which it reverses without sticking.
    """

    standing: FloatArray
    reversing: FloatArray


# Computed once for each recording, and kept as long as it lives: it takes two passes over the positions.
_known: WeakKeyDictionary[Recording, Phases] = WeakKeyDictionary()


def find_phases(recording: Recording) -> Phases:
    """Return the phases of a recording, computed once."""
    if recording not in _known:
        phases = find_passive_phases(recording, lambda q: q, recording.n)
        segments = range(len(recording.segments)) if recording.torque_ranges else ()
        _known[recording] = replace(phases, clipped=tuple(_find_clipped(recording, k) for k in segments))
    return _known[recording]


def find_passive_phases(recording: Recording, positions: Callable[[FloatArray], FloatArray], n: int) -> Phases:
    """Return the phases of joints whose positions follow from those of the recorded joints, sample by sample.

    Parameters
    ----------
    recording : Recording
        The checked recording.
    positions : function
        Gives positions (m, n) of these joints from those (m, N) of the recorded ones.
    n : int
        Number of these joints.

    Returns
    -------
    Phases
        The halts of these joints in every segment.
    """
    return Phases(tuple(_find_halts(recording, k, positions, n) for k in range(len(recording.segments))))


def phase_shares(recording: Recording) -> PhaseShares:
    """Return how much of a recording, inside its windows, every joint stands or reverses: as recorded, without filters.

    Parameters
    ----------
    recording : Recording
        The checked recording.

    Returns
    -------
    PhaseShares
        The shares of all joints.
    """
    if has_poses(recording):
        return PhaseShares(np.ones(recording.n), np.zeros(recording.n))
    phases = find_phases(recording)
    # Halts begin and end at samples: only rounding is between them.
    width = 1e-3 * recording.period
    counts, total = np.zeros((len(Phase), recording.n)), 0
    for k, segment in enumerate(recording.segments):
        for first in range(0, segment.length, _COUNTED):
            samples = np.arange(first, min(first + _COUNTED, segment.length), dtype=np.float64)
            t: FloatArray = segment.start_time + samples * recording.period
            t = t[recording.inside_windows(t)]
            # In blocks: the phases of all samples at once would take much more memory than the halts that they come
            # from.
            phase_rows = phases.phases_at(k, t, width)
            counts += np.array([(phase_rows == phase).sum(axis=0) for phase in Phase])
            total += len(t)
    shares = counts / max(total, 1)
    return PhaseShares(shares[Phase.STANDING], shares[Phase.REVERSING])


def _find_halts(
    recording: Recording, index: int, positions: Callable[[FloatArray], FloatArray], n: int
) -> tuple[Halts, ...]:
    """Return the halts of n joints in a segment, from its raw positions, read twice in blocks."""
    segment, rate = recording.segments[index], recording.sampling_rate

    def read_blocks() -> Iterator[FloatArray]:
        for rows in recording.source.rows(segment.first_row, segment.length, READ_LENGTH):
            yield positions(rows.q)

    paths = _survey_positions(read_blocks(), n, rate)
    whole = segment.start_time, segment.start_time + max(segment.length - 1, 0) / rate
    runs = [_SpeedRuns() if path.moves else None for path in paths]
    reach = max((path.reach for path in paths), default=1)
    held, first = np.zeros((0, n)), 0
    for q in read_blocks():
        joined = np.concatenate([held, q])
        for j, (path, run) in enumerate(zip(paths, runs, strict=True)):
            if run is not None:
                run.push(joined[:, j], first, len(held) > 0, path, reach)
        # A speed is taken over `reach` samples to either side: so many rows are needed again with the next block.
        keep = min(2 * reach + 1, len(joined))
        first += len(joined) - keep
        held = joined[len(joined) - keep :]
    return tuple(
        _make_standstill(*whole) if run is None else run.find_halts(path, segment.start_time, segment.length, rate)
        for path, run in zip(paths, runs, strict=True)
    )


def _find_clipped(recording: Recording, index: int) -> tuple[Halts, ...]:
    """Return when the torque of each joint stands at its range, in a segment."""
    segment, (low, high) = recording.segments[index], np.transpose(recording.torque_ranges)
    runs, first = [array("q") for _ in range(recording.n)], 0
    for rows in recording.source.rows(segment.first_row, segment.length, READ_LENGTH):
        beyond = is_out_of_range(rows.tau, low, high)
        for joint in np.flatnonzero(beyond.any(axis=0)):
            for a, b in find_spans(beyond[:, joint]):
                _append_run(runs[joint], first + a, first + b, 1)
        first += len(beyond)
    rows_of = (np.array(run, dtype=np.int64).reshape(-1, 3)[:, :2] for run in runs)
    return tuple(_make_standstill(*(segment.start_time + rows.T * recording.period)) for rows in rows_of)


def _make_standstill(start: FloatArray | float, end: FloatArray | float) -> Halts:
    starts, ends = np.atleast_1d(start), np.atleast_1d(end)
    return Halts(starts, ends, np.ones(len(starts), dtype=bool), np.zeros(len(starts), dtype=bool))


@dataclass(frozen=True)
class _SpeedRule:
    """One joint's positions in a segment: whether it `moves`, and how its speed is computed.

    Speeds are differences over `reach` samples to either side, times `factor`; below `slow` it may as well stand.
    """

    moves: bool
    reach: int
    factor: float
    slow: float


def _survey_positions(blocks: Iterator[FloatArray], n: int, rate: float) -> list[_SpeedRule]:
    """Look at all positions once: spans, rms speeds, and a sample that tells their resolution."""
    low, high, squares, count = np.full(n, np.inf), np.full(n, -np.inf), np.zeros(n), 0
    sample, last = np.zeros((0, n)), np.zeros((0, n))
    for q in blocks:
        low, high = np.minimum(low, q.min(axis=0)), np.maximum(high, q.max(axis=0))
        squares += (np.diff(np.concatenate([last, q]), axis=0) ** 2).sum(axis=0)
        count += len(q)
        last = q[-1:]
        if len(sample) < _SURVEYED:
            # The first samples of a segment tell its resolution: it is the encoder's, and stays the same.
            sample = np.concatenate([sample, q[: _SURVEYED - len(sample)]])
    return [
        _choose_speed_rule(
            sample[:, j], count, float(high[j] - low[j]), float(np.sqrt(squares[j] / max(count - 1, 1))) * rate, rate
        )
        for j in range(n)
    ]


def _choose_speed_rule(sample: FloatArray, count: int, travel: float, rms: float, rate: float) -> _SpeedRule:
    if count < 3 or travel <= STANDS:
        return _SpeedRule(False, 1, 0.5 * rate, SLOW)
    slow = min(SLOW, SLOW_SHARE * rms)
    # Three standard deviations of a difference of two positions.
    uncertain = np.sqrt(2.0) * _DEVIATIONS * _measure_resolution(sample)
    # The noise of a speed is that of two positions over the time between them: coarse positions need more time.
    needed = max(uncertain / max(slow, 1e-12), _SHORTEST_STEP)
    reach = min(max(1, ceil(0.5 * rate * min(needed, _LONGEST_STEP))), (count - 1) // 2)
    return _SpeedRule(True, reach, rate / (2 * reach), max(slow, uncertain * rate / (2 * reach)))


class _SpeedRuns:
    """Runs of samples at which one joint is slow or fast, collected block by block."""

    def __init__(self) -> None:
        # Of each run its first and last sample, and whether it is slow anywhere; its direction at either end.
        self._near = array("q")
        self._fast = array("q")
        self._before = np.nan
        self._squares = 0.0

    def push(self, q: FloatArray, first: int, goes_on: bool, path: _SpeedRule, reach: int) -> None:
        """Take positions (m,) from sample `first` on; of a run that goes on, 2 reach + 1 are known already."""
        speed = (q[2 * path.reach :] - q[: -2 * path.reach]) * path.factor
        # All joints hold back as many rows as the one with the longest reach needs. A joint with a shorter reach has
        # seen the first of these speeds already.
        new = 2 * reach + 1 - 2 * path.reach if goes_on else 0
        speed, start = speed[new:], first + new + path.reach
        if not len(speed):
            return
        self._squares += float((speed**2).sum())
        is_slow = np.abs(speed) < path.slow
        # So quick a turn that no sample of it is slow.
        signs = np.sign(np.concatenate([[speed[0] if np.isnan(self._before) else self._before], speed]))
        is_slow |= signs[1:] != signs[:-1]
        self._before = float(speed[-1])
        so_far = np.concatenate([[0], np.cumsum(is_slow)])
        for a, b in find_spans(is_slow | (np.abs(speed) < _SLOWLY * path.slow)):
            _append_run(self._near, start + a, start + b, int(so_far[b + 1] > so_far[a]))
        for a, b in find_spans(~is_slow & (np.abs(speed) >= FASTER * path.slow)):
            _append_run(self._fast, start + a, start + b, int(np.sign(speed[a])), int(np.sign(speed[b])))

    def find_halts(self, path: _SpeedRule, start: float, length: int, rate: float) -> Halts:
        """Return when the joint is slow.

        Where positions are too coarse or too noisy to tell, it stands throughout if it is slow all in all, and never
        otherwise.
        """
        near = np.array(self._near, dtype=np.int64).reshape(-1, 3)
        halts = near[near[:, 2] > 0, :2]
        rms = np.sqrt(self._squares / max(length - 2 * path.reach, 1))
        untold = path.slow > _UNTOLD * rms
        if untold and rms < SLOW:
            return _make_standstill(start, start + max(length - 1, 0) / rate)
        if untold or not len(halts):
            nothing = np.zeros(0, dtype=bool)
            return Halts(np.zeros(0), np.zeros(0), nothing, nothing)
        first, last = halts.T
        # What is slow where speeds begin and end is so up to the segment's ends.
        first = np.where(first <= path.reach, 0, first)
        last = np.where(last >= length - 1 - path.reach, length - 1, last)
        fast = np.array(self._fast, dtype=np.int64).reshape(-1, 4)
        return Halts(start + first / rate, start + last / rate, *_find_sticking(fast, first, last))


def find_spans(mask: BoolArray) -> list[tuple[int, int]]:
    """Return first and last index of every run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _append_run(runs: array[int], first: int, last: int, *more: int) -> None:
    """Append a run to the others, or extend the last one if it goes on.

    Of `more`, one number is true or false of any part of the run, and the last of two is about its end.
    """
    width = 2 + len(more)
    if len(runs) and runs[1 - width] == first - 1:
        runs[1 - width] = last
        runs[-1] = max(runs[-1], more[-1]) if len(more) == 1 else more[-1]
    else:
        runs.extend((first, last, *more))


def _measure_resolution(q: FloatArray) -> float:
    """Return the standard deviation of one position about its surroundings: noise, or rounding."""
    if len(q) < 3:
        return 0.0
    # Second differences are free of smooth motion. Their variance is 1 + 4 + 1 = 6 times the noise's, and 1.4826
    # makes the median of absolute values a standard deviation.
    noise = float(np.median(np.abs(q[2:] - 2.0 * q[1:-1] + q[:-2]))) * 1.4826 / np.sqrt(6.0)
    steps = np.abs(np.diff(q))
    steps = steps[steps > 0]
    quantum = float(np.quantile(steps, 0.02)) if len(steps) else 0.0
    # Rounding to steps of a size is spread evenly over it: its standard deviation is the size / √12.
    return float(max(noise, quantum / np.sqrt(12.0)))


def _find_sticking(fast: IntArray, first: IntArray, last: IntArray) -> tuple[BoolArray, BoolArray]:
    """Return which halts are no free turns, and which are reversals.

    Parameters
    ----------
    fast : (f, 4)
        First and last sample of every run at which the joint is fast, and its direction at either.
    first, last : (k,)
        Samples of the halts.
    """
    sticks, turns = np.ones(len(first), dtype=bool), np.zeros(len(first), dtype=bool)
    before = np.searchsorted(fast[:, 1], first) - 1
    behind = np.searchsorted(fast[:, 0], last, side="right")
    inside = np.flatnonzero((before >= 0) & (behind < len(fast)))
    if not len(inside):
        return sticks, turns
    came, went = fast[before[inside]], fast[behind[inside]]
    # The time from fast to slow or from slow to fast, the shorter of the two: the larger acceleration.
    side = np.minimum(first[inside] - came[:, 1], went[:, 0] - last[inside])
    # From 5 to 2 times the slow speed, and from 2 times one way to 2 times the other, at one acceleration.
    free = side * (2.0 * _SLOWLY / (FASTER - _SLOWLY))
    turns[inside] = came[:, 3] != went[:, 2]
    sticks[inside] = ~turns[inside] | (last[inside] - first[inside] > _LINGERS * free + _SAMPLES)
    return sticks, turns
