"""Inner products straight from filtered rows, apart for rows where a joint moves and where it turns round.

A motion that is repeated shows the same again: whatever differs from the truth does so at the same place of every
period, and a function that is wrong but flexible predicts it in one period as well as in the next. So all that is at
one place of the period is one stretch, however often it was driven, and what is left out is other motion.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from dynident.arrays import BoolArray, FloatArray, IndexArray
from dynident.diagnosis.candidates.collecting import MANY, Collected, Stretches
from dynident.diagnosis.candidates.products import Products, Stack
from dynident.diagnosis.comparing.repetition import periods_of
from dynident.effects import ReferenceParameters, Signals
from dynident.progress import Progress, silent
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.phases import Phase, width_of
from dynident.regressors.folding import stretch_length, used_duration
from dynident.regressors.observation import Observation
from dynident.regressors.row_phases import RowPhases, joints_with_friction, lives_at_starts
from dynident.regressors.stream import FilteredSamples, filtered_samples

_FINER = 0.25
"""Stretches are so much shorter than those that an identification keeps: the more there are, the surer is what gains in
most of them, as long as they are long against the filters' memory."""

_MOST = 160
"""Stretches in all: more make the test no sharper, and each holds products of all columns with each other."""

_KINDS = 3
"""Of rows: moving, turning, partial."""

_LONG = 2.0
"""Times the width that the filters smear to either side: what is in one stretch is then so little in the next that the
test keeps its level (`benchmarks/decision_level.py`)."""


@dataclass(frozen=True, eq=False)
class Elsewhere:
    """Rows that are shown only to what lives there: `stacks`, their products, one a joint; `counts` (s, n).

    `shown` (columns, n): for which columns they are equations of which joint.
    """

    stacks: tuple[Stack, ...]
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

    def of(self, columns: Sequence[int] | IndexArray) -> Products:
        """The rows that are equations for a model with these columns."""
        return self._rows(self.shown(columns))

    def beside(self, columns: Sequence[int] | IndexArray, kinds: BoolArray) -> Products:
        """Those, and on all joints those of some kinds (2,): turning and partial rows, for candidates on any joint."""
        return self._rows(self.shown(columns) | kinds[:, None])

    def counts(self, columns: Sequence[int] | IndexArray) -> FloatArray:
        """(s, n): how many rows are equations for a model with these columns."""
        turns, starts = self.shown(columns)
        return np.asarray(self.moving.counts + turns * self.turning.counts + starts * self.partial.counts)

    def shown(self, columns: Sequence[int] | IndexArray) -> BoolArray:
        """(2, n): joints whose turning, and whose partial rows are equations for a model with these columns."""
        own = np.asarray(columns, dtype=np.intp)
        return np.array([rows.shown[own].any(axis=0) for rows in (self.turning, self.partial)])

    def kinds(self, columns: Sequence[int] | IndexArray) -> tuple[bool, bool]:
        """Whether turning, and whether partial rows of any joint are equations for a model with these columns."""
        turns, starts = self.shown(columns)
        return bool(turns.any()), bool(starts.any())

    def _rows(self, used: BoolArray) -> Products:
        """Rows in which each joint moves, and those of `used` (2, n): where it turns, and of motion beside a halt."""
        more = [
            [
                rows
                for rows, use in zip((self.turning, self.partial), own, strict=True)
                if use and rows.counts[:, j].any()
            ]
            for j, own in enumerate(used.T)
        ]
        if not any(more):
            return self.moving
        counts = self.moving.counts.copy()
        for j, own in enumerate(more):
            for rows in own:
                counts[:, j] += rows.counts[:, j]
        stacks = (
            (*plain, *(rows.stacks[j] for rows in own))
            for j, (plain, own) in enumerate(zip(self.moving.stacks, more, strict=True))
        )
        return Products(tuple(stacks), self.moving.position, counts, self.moving.run)


def gather(
    observation: Observation,
    signals: Signals,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    n_base: int,
    progress: Progress = silent,
    samples_of: Callable[[Recording], Iterable[FilteredSamples]] | None = None,
) -> PhasedProducts:
    """Inner products of all columns and Y, a stretch of time and joint at a time; W is never stored.

    Parameters
    ----------
    reference : ReferenceParameters
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
    total = sum(used_duration(recording) for recording in recordings)
    usual = max(_FINER * stretch_length(recordings), total / _MOST)
    repeats = [periods_of(recording) for recording in recordings]
    n_periodic = sum(1 + MANY * len(periods) for each in repeats for periods in each)
    stretches = Stretches(usual, _LONG * width)
    collected = Collected([len(columns) for _, columns in layout], _KINDS, int(total / usual) + n_periodic)
    done, free = 0.0, np.ones(n, dtype=bool)
    for recording, periods in zip(recordings, repeats, strict=True):
        phases = RowPhases.of(observation, recording, preprocessing, n_base).about(frictional)
        free &= phases.free
        if samples_of is None:
            samples_of_recording: Iterable[FilteredSamples] = filtered_samples(
                observation, recording, preprocessing, reference, phases=phases
            )
        else:
            samples_of_recording = samples_of(recording)
        segment = -1
        for samples in samples_of_recording:
            if samples.segment != segment:
                segment = samples.segment
                stretches.begin_run(recording.run_label(segment), periods[segment])
            phase = phases.at(segment, samples.t)
            partial_rows = phases.partial(segment, samples.t, phase, samples.held)
            collected.push(
                stretches.of(samples.t),
                samples.rows(layout),
                (phase == Phase.MOVING, phase == Phase.REVERSING, partial_rows),
            )
            progress(min(1.0, (done + samples.t[-1] - recording.segments[0].start_time) / total), recording.name)
        done += used_duration(recording)
    starts = lives_at_starts(observation)
    turns = _remembering(observation, signals) | (starts & free)
    run = stretches.runs()
    (stacks, counts), turning, partial = collected.finished(len(run))
    position = tuple(_places(columns, observation.n_columns) for _, columns in layout)
    moving = Products(tuple((stack,) for stack in stacks), position, counts, run)
    return PhasedProducts(moving, Elsewhere(*turning, turns), Elsewhere(*partial, starts))


def _places(columns: IndexArray, count: int) -> IndexArray:
    """(count,): where each of all columns stands among those that a joint has, -1 where it lacks it."""
    where = np.full(count, -1, dtype=np.intp)
    where[columns] = np.arange(len(columns))
    return where


def _remembering(observation: Observation, signals: Signals) -> BoolArray:
    """(columns, n): which columns are functions of a joint's path."""
    has_memory = np.zeros((observation.n_columns, observation.robot.n), dtype=bool)
    if observation.memory:
        for k, column in enumerate(observation.columns):
            for signal in signals.memory_in(column.torque):
                has_memory[k, list(observation.robot.position_movers(signal.joint))] = True
    return has_memory
