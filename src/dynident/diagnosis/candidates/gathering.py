"""Inner products straight from filtered rows, apart for rows where a joint moves and where it turns round.

A motion that is repeated shows the same again: whatever differs from the truth does so at the same place of every
period, and a function that is wrong but flexible predicts it in one period as well as in the next. So all that is at
one place of the period is one stretch, however often it was driven, and what is left out is other motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynident.diagnosis.candidates.products import IntArray, Products
from dynident.diagnosis.comparing.repetition import Repeat, periods_of
from dynident.effects import Signals
from dynident.progress import Progress, silent
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.phases import Phase, width_of
from dynident.recordings.types import BoolArray
from dynident.regressors.observation import Observation
from dynident.regressors.row_phases import RowPhases, joints_with_friction, lives_at_starts
from dynident.regressors.stream import FilteredSamples, filtered_samples, stretch_length
from dynident.robot.model import FloatArray

_FINER = 0.25
"""Stretches are so much shorter than those that an identification keeps: the more there are, the surer is what gains in
most of them, as long as they are long against the filters' memory."""

_KINDS = 3
"""Of rows: moving, turning, partial."""

_LONG = 4.0
"""Times the width that the filters smear to either side: what is in one stretch is then hardly in the next."""


@dataclass(frozen=True, eq=False)
class Elsewhere:
    """Rows that are shown only to what lives there: `grams`, one (s, p_j + 1, p_j + 1) a joint; `counts` (s, n).

    `shown` (columns, n): for which columns they are equations of which joint.
    """

    grams: tuple[FloatArray, ...]
    counts: FloatArray
    shown: BoolArray


@dataclass(frozen=True, eq=False)
class PhasedProducts:
    """What all scores are computed from: `moving` of rows where the equation's joint moves.

    `turning`: where it turns round without sticking, shown to friction that remembers its path, or is about low speeds
    where it never sticks; `partial`: of the motion beside a halt, shown to friction that lives where a joint starts.
    """

    moving: Products
    turning: Elsewhere
    partial: Elsewhere
    _known: dict[tuple[int, bool, bool], FloatArray] = field(default_factory=dict)

    def of(self, columns: Sequence[int] | IntArray) -> Products:
        """The rows that are equations for a model with these columns."""
        return self.rows(self.shown(columns))

    def beside(self, columns: Sequence[int] | IntArray, kinds: BoolArray) -> Products:
        """Those, and on all joints those of some kinds (2,): turning and partial rows, for candidates on any joint."""
        return self.rows(self.shown(columns) | kinds[:, None])

    def rows(self, used: BoolArray) -> Products:
        """Rows in which each joint moves, and those of `used` (2, n): where it turns, and of motion beside a halt."""
        if not used.any():
            return self.moving
        grams = tuple(self._gram(j, bool(turns), bool(starts)) for j, (turns, starts) in enumerate(used.T))
        counts = self.moving.counts + used[0] * self.turning.counts + used[1] * self.partial.counts
        return Products(grams, self.moving.position, counts, self.moving.run)

    def shown(self, columns: Sequence[int] | IntArray) -> BoolArray:
        """(2, n): joints whose turning, and whose partial rows are equations for a model with these columns."""
        own = np.asarray(columns, dtype=np.intp)
        return np.array([rows.shown[own].any(axis=0) for rows in (self.turning, self.partial)])

    def _gram(self, joint: int, turns: bool, starts: bool) -> FloatArray:
        if (joint, turns, starts) not in self._known:
            gram = self.moving.grams[joint]
            for use, rows in ((turns, self.turning), (starts, self.partial)):
                gram = gram + rows.grams[joint] if use else gram
            self._known[joint, turns, starts] = gram
        return self._known[joint, turns, starts]


def gather(
    observation: Observation,
    signals: Signals,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
    n_base: int,
    progress: Progress = silent,
    samples_of: Callable[[Recording], Iterable[FilteredSamples]] | None = None,
) -> PhasedProducts:
    """Inner products of all columns and Y, a stretch of time and joint at a time; W is never stored.

    Parameters
    ----------
    reference : (14 n,)
        What loads are predicted with.
    n_base : int
        Columns of the model itself: their friction says whose rows depend on the phase.
    samples_of : function, optional
        Gives a recording's filtered samples, where they are at hand.
    """
    n = observation.robot.n
    layout = [observation.joint_entries(joint) for joint in range(n)]
    frictional = joints_with_friction(observation, n_base)
    width = width_of(preprocessing, recordings[0].sampling_rate)
    sums = _Sums([len(columns) for _, columns in layout], _FINER * stretch_length(recordings), _LONG * width)
    total = sum(recording.n_samples for recording in recordings) / recordings[0].sampling_rate
    done, free = 0.0, np.ones(n, dtype=bool)
    for recording in recordings:
        phases = RowPhases.of(observation, recording, preprocessing).about(frictional)
        periods = periods_of(recording)
        free &= phases.free
        if samples_of is None:
            given: Iterable[FilteredSamples] = filtered_samples(
                observation, recording, preprocessing, reference, phases=phases
            )
        else:
            given = samples_of(recording)
        segment = -1
        for samples in given:
            if samples.segment != segment:
                segment = samples.segment
                sums.begin_run(recording.run_label(segment), periods[segment])
            phase = phases.at(segment, samples.t)
            partial = phases.partial(phase, samples.held)
            sums.push(samples.t, samples.rows(layout), phase == Phase.MOVING, phase == Phase.REVERSING, partial)
            progress(min(1.0, (done + samples.t[-1] - recording.segments[0].start_time) / total), recording.name)
        done += recording.n_samples / recording.sampling_rate
    starts = lives_at_starts(observation)
    turns = _remembering(observation, signals) | (starts & free)
    return sums.finished([columns for _, columns in layout], turns, starts)


class _Sums:
    """Inner products of the stretches of time, as rows come."""

    def __init__(self, widths: Sequence[int], usual: float, shortest: float) -> None:
        self._usual, self._shortest = max(usual, shortest), shortest
        self._shapes = [(width + 1, width + 1) for width in widths]
        self._grams: list[list[list[FloatArray]]] = [[[] for _ in widths] for _ in range(_KINDS)]
        self._counts: list[list[FloatArray]] = [[] for _ in range(_KINDS)]
        self._now = 0
        self._runs: list[str] = []
        self._run = ""
        self._periods: Sequence[Repeat] = ()
        self._begun: dict[tuple[int, int], int] = {}
        self._end = -np.inf

    def begin_run(self, label: str, periods: Sequence[Repeat]) -> None:
        """The next rows are of this run, which repeats itself where `periods` say; stretches end with it."""
        self._run, self._periods = label, periods
        self._begun = {}
        self._end = -np.inf

    def push(self, t: FloatArray, rows: Sequence[FloatArray], *used: BoolArray) -> None:
        """Add [W | Y] (m, p + 1) of every joint; `used` (m, n) of every kind."""
        first = 0
        while first < len(t):
            if t[first] >= self._end:
                self._begin(float(t[first]))
            last = first + max(1, int(np.searchsorted(t[first:], self._end)))
            for kind, mask in enumerate(used):
                for j, block in enumerate(rows):
                    part = block[first:last][mask[first:last, j]]
                    if len(part):
                        self._grams[kind][j][self._now] += part.T @ part
                        self._counts[kind][self._now][j] += len(part)
            first = last

    def _begin(self, start: float) -> None:
        """Open the stretch that begins at a time or, where the motion has been here before, that of then."""
        for number, period in enumerate(self._periods):
            if period.start <= start < period.end + period.lag:
                length = period.lag / max(1, int(period.lag / self._shortest))
                since = (start - period.start) % period.lag
                place = int(since / length)
                self._end = start - since + (place + 1) * length
                self._now = self._begun.setdefault((number, place), len(self._runs))
                break
        else:
            self._end, self._now = start + self._usual, len(self._runs)
        if self._now == len(self._runs):
            self._add()

    def _add(self) -> None:
        self._runs.append(self._run)
        for kind in range(_KINDS):
            self._counts[kind].append(np.zeros(len(self._shapes)))
            for j, shape in enumerate(self._shapes):
                self._grams[kind][j].append(np.zeros(shape))

    def finished(self, columns: Sequence[IntArray], turns: BoolArray, starts: BoolArray) -> PhasedProducts:
        """All of them, with the places of the columns, and (columns, n) to which the rarer rows are shown."""
        grams = [
            tuple(np.array(g).reshape(-1, *shape) for g, shape in zip(kind, self._shapes, strict=True))
            for kind in self._grams
        ]
        counts = [np.array(kind).reshape(-1, len(self._shapes)) for kind in self._counts]
        position = []
        for own in columns:
            where = np.full(len(turns), -1, dtype=np.intp)
            where[own] = np.arange(len(own))
            position.append(where)
        labels = list(dict.fromkeys(self._runs))
        run = np.array([labels.index(label) for label in self._runs], dtype=np.intp)
        moving = Products(grams[0], tuple(position), counts[0], run)
        return PhasedProducts(moving, Elsewhere(grams[1], counts[1], turns), Elsewhere(grams[2], counts[2], starts))


def _remembering(observation: Observation, signals: Signals) -> BoolArray:
    """(columns, n): which columns are functions of a joint's path."""
    found = np.zeros((observation.n_columns, observation.robot.n), dtype=bool)
    if observation.memory:
        for k, column in enumerate(observation.columns):
            found[k, [signal.joint for signal in signals.memory_in(column.torque)]] = True
    return found
