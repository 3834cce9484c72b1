"""When a joint moves, turns round or stands still: decided once, from the raw positions, for all that uses rows.

Dry friction has a sign only while a joint moves. Where it stands or sticks, its torque is whatever holds it, anything
up to its static friction, and `Fc sign(q̇)` says nothing. Where it turns round without sticking, the sign changes
within what the filters smear: only friction that remembers the path (presliding) says how.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from math import ceil
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dynident.recordings.filtering import READ_LENGTH
from dynident.recordings.preprocessing import Preprocessing
from dynident.recordings.types import BoolArray, FloatArray, IntArray, Recording

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

_FASTER = 5.0
"""Times the slow speed that a joint which turns freely comes from and goes to; in between its acceleration lasts."""

_LINGERS = 1.5
"""It sticks if it stays so many times longer than it would turning freely, at the larger of its accelerations before
and behind. Of sticks that are most of a halt hardly one is then called free, of those that are short beside the turn a
third (`benchmarks/standing_rows.py`): nobody can tell them from a turn."""

_UNTOLD = 0.2
"""Share of its rms speed that a joint's speed is uncertain by, from where on nobody can tell when it stands."""

_SELDOM = 0.1
"""Share of its turns at which a joint that turns freely may seem to stick."""

_SAMPLES = 2
"""Samples by which a time between two speeds is uncertain."""


class Phase(IntEnum):
    """What a joint does at a row."""

    MOVING = 0
    REVERSING = 1
    STANDING = 2


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

    def near(self, t: FloatArray, before: float, after: float, chosen: BoolArray) -> BoolArray:
        """(m,): which of the times t (m,) are at most `before` s ahead of, or `after` s behind, a chosen halt."""
        starts, ends = self.starts[chosen] - before, self.ends[chosen] + after
        begun = np.searchsorted(starts, t, side="right")
        over = np.searchsorted(ends, t, side="left")
        return np.asarray(begun > over)


@dataclass(frozen=True, eq=False)
class Phases:
    """The halts of all joints in every segment of a recording: `halts[segment][joint]`."""

    halts: tuple[tuple[Halts, ...], ...]

    @property
    def free(self) -> BoolArray:
        """(n,): joints that turn round without sticking nearly always.

        Where a joint sticks at some of its turns, it may stick unseen, for a moment, at the others.
        """
        found = []
        for joint in zip(*self.halts, strict=True):
            turns = np.concatenate([halts.turns for halts in joint])
            sticks = np.concatenate([halts.sticks for halts in joint])[turns]
            found.append(len(sticks) > 0 and float(sticks.mean()) <= _SELDOM)
        return np.array(found, dtype=bool)

    def at(self, segment: int, t: FloatArray, width: float, after: float = 0.0) -> PhaseArray:
        """(m, n): the phase of every joint at times t (m,) of a segment.

        Parameters
        ----------
        width : float
            Seconds that a filter smears to either side: rows nearer than that to a halt are part of it.
        after : float
            Seconds that a halt is felt later on top of that, by a filter with a memory.
        """
        out = np.zeros((len(t), len(self.halts[segment])), dtype=np.int8)
        for j, halts in enumerate(self.halts[segment]):
            everyone = np.ones(len(halts.starts), dtype=bool)
            out[halts.near(t, width, width + after, everyone), j] = Phase.REVERSING
            out[halts.near(t, width, width + after, halts.sticks), j] = Phase.STANDING
        return out


def width_of(preprocessing: Preprocessing, rate: float) -> float:
    """Seconds that the filters smear a halt over, to either side: 1 / the lower cut-off; a period without filters."""
    cutoffs = [f for f in (preprocessing.position_cutoff, preprocessing.torque_cutoff) if f is not None]
    # Half a period more, so that rounding does not decide about rows on the border.
    return (1.0 / min(cutoffs) if cutoffs else 1.0 / rate) + 0.5 / rate


@dataclass(frozen=True, eq=False)
class PhaseShares:
    """Share (n,) of every joint's time in which it stands, and in which it turns round; in the rest it moves."""

    standing: FloatArray
    reversing: FloatArray


_known: WeakKeyDictionary[Recording, Phases] = WeakKeyDictionary()


def phases_of(recording: Recording) -> Phases:
    """The phases of a recording, found once."""
    if recording not in _known:
        _known[recording] = Phases(tuple(_in_segment(recording, k) for k in range(len(recording.segments))))
    return _known[recording]


def phase_shares(recording: Recording) -> PhaseShares:
    """How much of a recording, inside its windows, every joint stands or turns round: as recorded, without filters."""
    phases = phases_of(recording)
    # Halts begin and end at samples: only rounding is between them.
    width = 1e-3 * recording.period
    counts, total = np.zeros((len(Phase), recording.n)), 0
    for k, segment in enumerate(recording.segments):
        t: FloatArray = segment.start_time + np.arange(segment.length, dtype=np.float64) * recording.period
        t = t[recording.inside_windows(t)]
        found = phases.at(k, t, width)
        counts += np.array([(found == phase).sum(axis=0) for phase in Phase])
        total += len(t)
    shares = counts / max(total, 1)
    return PhaseShares(shares[Phase.STANDING], shares[Phase.REVERSING])


def _in_segment(recording: Recording, index: int) -> tuple[Halts, ...]:
    """The halts of all joints in a segment, from its raw positions."""
    segment, rate = recording.segments[index], recording.sampling_rate
    blocks = [rows.q for rows in recording.source.rows(segment.first_row, segment.length, READ_LENGTH)]
    path = np.concatenate(blocks) if blocks else np.zeros((0, recording.n))
    return tuple(
        _halts(path[:, j], segment.start_time, rate, _slow_speed(path[:, j], rate)) for j in range(recording.n)
    )


def _slow_speed(q: FloatArray, rate: float) -> float:
    """The speed below which a joint counts as slow; one that moves slowly throughout a run has a lower one."""
    if len(q) < 2:
        return SLOW
    return float(min(SLOW, SLOW_SHARE * np.sqrt((np.diff(q) ** 2).mean()) * rate))


def _resolution(q: FloatArray) -> float:
    """Standard deviation of one position about its surroundings: noise, or what rounding leaves."""
    if len(q) < 3:
        return 0.0
    noise = float(np.median(np.abs(q[2:] - 2.0 * q[1:-1] + q[:-2]))) * 1.4826 / np.sqrt(6.0)
    steps = np.abs(np.diff(q))
    steps = steps[steps > 0]
    quantum = float(np.quantile(steps, 0.02)) if len(steps) else 0.0
    return float(max(noise, quantum / np.sqrt(12.0)))


def _halts(q: FloatArray, start: float, rate: float, slow: float) -> Halts:
    """When a joint is slow, from its positions (m,); never, where its positions are too noisy to tell."""
    if len(q) < 3 or float(np.ptp(q)) <= STANDS:
        whole = np.array([start]), np.array([start + max(len(q) - 1, 0) / rate])
        return Halts(*whole, np.ones(1, dtype=bool), np.zeros(1, dtype=bool))
    resolution = _resolution(q)
    wanted = np.sqrt(2.0) * _DEVIATIONS * resolution / max(slow, 1e-12)
    reach = max(1, ceil(0.5 * rate * min(max(wanted, _SHORTEST_STEP), _LONGEST_STEP)))
    reach = min(reach, (len(q) - 1) // 2)
    slow = max(slow, np.sqrt(2.0) * _DEVIATIONS * resolution * rate / (2 * reach))
    speed = _speeds(q, reach, rate)
    if slow > _UNTOLD * float(np.sqrt((speed**2).mean())):
        nothing = np.zeros(0, dtype=bool)
        return Halts(np.zeros(0), np.zeros(0), nothing, nothing)
    first, last = _slow_parts(speed, slow)
    return Halts(start + first / rate, start + last / rate, *_sticking(speed, first, last, slow))


def _slow_parts(speed: FloatArray, slow: float) -> tuple[IntArray, IntArray]:
    """First and last sample (k,) of every halt: below twice the slow speed, and somewhere below once it."""
    is_slow = np.abs(speed) < slow
    # So quick a turn that no sample of it is slow.
    is_slow[1:] |= np.sign(speed[1:]) != np.sign(speed[:-1])
    near = is_slow | (np.abs(speed) < _SLOWLY * slow)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], near, [False]]).astype(np.int8)))
    first, last = edges[::2], edges[1::2] - 1
    so_far = np.concatenate([[0], np.cumsum(is_slow)])
    halts = so_far[last + 1] > so_far[first]
    return first[halts], last[halts]


def _speeds(q: FloatArray, reach: int, rate: float) -> FloatArray:
    """(m,): differences over `reach` samples to either side; at the ends those of the nearest inner sample."""
    inner = (q[2 * reach :] - q[: -2 * reach]) * (rate / (2 * reach))
    return np.pad(inner, reach, mode="edge")


def _sticking(speed: FloatArray, first: IntArray, last: IntArray, slow: float) -> tuple[BoolArray, BoolArray]:
    """(k,), (k,): halts, from sample `first` to `last` (k,), that are no free turns; and those that are turns."""
    sticks, turns = np.ones(len(first), dtype=bool), np.zeros(len(first), dtype=bool)
    fast = np.flatnonzero(np.abs(speed) >= _FASTER * slow)
    before = np.searchsorted(fast, first) - 1
    behind = np.searchsorted(fast, last, side="right")
    inside = np.flatnonzero((before >= 0) & (behind < len(fast)))
    if not len(inside):
        return sticks, turns
    came, went = fast[before[inside]], fast[behind[inside]]
    side = np.minimum(first[inside] - came, went - last[inside])
    # From 5 to 2 times the slow speed, and from 2 times one way to 2 times the other, at one acceleration.
    free = side * (2.0 * _SLOWLY / (_FASTER - _SLOWLY))
    turns[inside] = np.sign(speed[came]) != np.sign(speed[went])
    sticks[inside] = ~turns[inside] | (last[inside] - first[inside] > _LINGERS * free + _SAMPLES)
    return sticks, turns
