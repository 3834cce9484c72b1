"""Inner products straight from filtered rows, apart for rows where a joint moves and where it turns round."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from dynident.diagnosis.candidates.products import IntArray, Products
from dynident.effects import Signals, effect_by_id
from dynident.progress import Progress, silent
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.phases import Phase, width_of
from dynident.recordings.types import BoolArray
from dynident.regressors.observation import Observation
from dynident.regressors.row_phases import RowPhases, joints_with_friction
from dynident.regressors.stream import FilteredSamples, filtered_samples, stretch_length
from dynident.robot.model import FloatArray

_FINER = 0.25
"""Stretches are so much shorter than those that an identification keeps: the more there are, the surer is what gains in
most of them, as long as they are long against the filters' memory."""

_LONG = 4.0
"""Times the width that the filters smear to either side: what is in one stretch is then hardly in the next."""


@dataclass(frozen=True, eq=False)
class PhasedProducts:
    """What all scores are computed from: `moving` of rows where the equation's joint moves.

    `turning`, one (s, p_j + 1, p_j + 1) a joint, and `turning_counts` (s, n), of rows where it turns round without
    sticking, shown to what lives there alone: `remembers` (columns, n) are the columns with friction that remembers a
    joint's path, or is about low speeds and sits on a joint that never sticks.
    """

    moving: Products
    turning: tuple[FloatArray, ...]
    turning_counts: FloatArray
    remembers: BoolArray
    _whole: dict[int, FloatArray] = field(default_factory=dict)

    def of(self, columns: Sequence[int] | IntArray) -> Products:
        """The rows that are equations for a model with these columns."""
        joints = self.remembered(columns)
        if not joints.any():
            return self.moving
        grams = tuple(
            self._together(j) if use else gram
            for j, (use, gram) in enumerate(zip(joints, self.moving.grams, strict=True))
        )
        counts = self.moving.counts + np.where(joints, self.turning_counts, 0.0)
        return Products(grams, self.moving.position, counts, self.moving.run)

    def remembered(self, columns: Sequence[int] | IntArray) -> BoolArray:
        """(n,): joints whose path some of these columns remember."""
        return np.asarray(self.remembers[np.asarray(columns, dtype=np.intp)].any(axis=0))

    def _together(self, joint: int) -> FloatArray:
        if joint not in self._whole:
            self._whole[joint] = self.moving.grams[joint] + self.turning[joint]
        return self._whole[joint]


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
    sums = _Sums([len(columns) for _, columns in layout], max(_FINER * stretch_length(recordings), _LONG * width))
    total = sum(recording.n_samples for recording in recordings) / recordings[0].sampling_rate
    done, free = 0.0, np.ones(n, dtype=bool)
    for recording in recordings:
        phases = RowPhases.of(observation, recording, preprocessing).about(frictional)
        free &= phases.free
        if samples_of is None:
            given: Iterable[FilteredSamples] = filtered_samples(observation, recording, preprocessing, reference)
        else:
            given = samples_of(recording)
        segment = -1
        for samples in given:
            if samples.segment != segment:
                segment = samples.segment
                sums.begin_run(recording.run_label(segment))
            phase = phases.at(segment, samples.t)
            rows = [
                np.hstack([samples.values[:, places], samples.tau[:, j : j + 1]])
                for j, (places, _) in enumerate(layout)
            ]
            sums.push(samples.t, rows, phase == Phase.MOVING, phase == Phase.REVERSING)
            progress(min(1.0, (done + samples.t[-1] - recording.segments[0].start_time) / total), recording.name)
        done += recording.n_samples / recording.sampling_rate
    return sums.finished([columns for _, columns in layout], _living_at_turns(observation, signals, free))


class _Sums:
    """Inner products of the stretches of time, as rows come."""

    def __init__(self, widths: Sequence[int], length: float) -> None:
        self._length = length
        self._shapes = [(width + 1, width + 1) for width in widths]
        self._grams: list[list[list[FloatArray]]] = [[[] for _ in widths] for _ in range(2)]
        self._counts: list[list[FloatArray]] = [[], []]
        self._spans: list[tuple[float, float]] = []
        self._runs: list[str] = []
        self._run = ""
        self._is_open = False

    def begin_run(self, label: str) -> None:
        """The next rows are of this run; stretches end with it."""
        self._run = label
        self._is_open = False

    def push(self, t: FloatArray, rows: Sequence[FloatArray], *used: BoolArray) -> None:
        """Add [W | Y] (m, p + 1) of every joint; `used` (m, n) of either kind."""
        first = 0
        while first < len(t):
            if not self._is_open:
                self._begin(float(t[first]))
            last = first + int(np.searchsorted(t[first:], self._spans[-1][0] + self._length))
            for kind, mask in enumerate(used):
                for j, block in enumerate(rows):
                    part = block[first:last][mask[first:last, j]]
                    if len(part):
                        self._grams[kind][j][-1] += part.T @ part
                        self._counts[kind][-1][j] += len(part)
            if last > first:
                self._spans[-1] = (self._spans[-1][0], float(t[last - 1]))
            if last < len(t):
                self._is_open = False
            first = last

    def _begin(self, start: float) -> None:
        self._is_open = True
        self._spans.append((start, start))
        self._runs.append(self._run)
        for kind in range(2):
            self._counts[kind].append(np.zeros(len(self._shapes)))
            for j, shape in enumerate(self._shapes):
                self._grams[kind][j].append(np.zeros(shape))

    def finished(self, columns: Sequence[IntArray], remembers: BoolArray) -> PhasedProducts:
        """All of them, with the places of the columns."""
        grams = [
            tuple(np.array(g).reshape(-1, *shape) for g, shape in zip(kind, self._shapes, strict=True))
            for kind in self._grams
        ]
        counts = [np.array(kind).reshape(-1, len(self._shapes)) for kind in self._counts]
        position = []
        for own in columns:
            where = np.full(len(remembers), -1, dtype=np.intp)
            where[own] = np.arange(len(own))
            position.append(where)
        labels = list(dict.fromkeys(self._runs))
        run = np.array([labels.index(label) for label in self._runs], dtype=np.intp)
        moving = Products(grams[0], tuple(position), counts[0], run)
        return PhasedProducts(moving, grams[1], counts[1], remembers)


def _living_at_turns(observation: Observation, signals: Signals, free: BoolArray) -> BoolArray:
    """(columns, n): which columns are functions of a joint's path, or of its low speeds where it is `free` (n,)."""
    names = observation.robot.joint_names
    found = np.zeros((observation.n_columns, observation.robot.n), dtype=bool)
    if observation.memory:
        for k, column in enumerate(observation.columns):
            found[k, [signal.joint for signal in signals.memory_in(column.torque)]] = True
    for k, column in enumerate(observation.columns):
        slow = column.effect and any(spec.resolved_by == "speed" for spec in effect_by_id(column.effect).shapes)
        if slow and column.link in names:
            joint = names.index(column.link)
            found[k, joint] |= free[joint]
    return found
