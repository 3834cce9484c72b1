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
from dynident.diagnosis.candidates.collecting import MANY, BlockNumbering, RowAccumulator
from dynident.diagnosis.candidates.products import Products, Stack
from dynident.diagnosis.comparing.repetition import find_periods
from dynident.effects import ReferenceParameters, Signals
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.recordings.phases import Phase, compute_smear_width
from dynident.regressors.folding import choose_block_length, compute_used_duration
from dynident.regressors.observation import Observation
from dynident.regressors.row_phases import RowPhases, find_joints_with_friction, shows_at_starts
from dynident.regressors.stream import FilteredSamples, stream_filtered_samples

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
class ConditionalRows:
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
    turning: ConditionalRows
    partial: ConditionalRows

    def select_for_model(self, columns: Sequence[int] | IndexArray) -> Products:
        """The rows that are equations for a model with these columns."""
        return self._combine_rows(self.select_joints(columns))

    def select_for_candidates(self, columns: Sequence[int] | IndexArray, kinds: BoolArray) -> Products:
        """Those, and on all joints those of some kinds (2,): turning and partial rows, for candidates on any joint."""
        return self._combine_rows(self.select_joints(columns) | kinds[:, None])

    def count_rows(self, columns: Sequence[int] | IndexArray) -> FloatArray:
        """(s, n): how many rows are equations for a model with these columns."""
        turns, starts = self.select_joints(columns)
        return np.asarray(self.moving.counts + turns * self.turning.counts + starts * self.partial.counts)

    def select_joints(self, columns: Sequence[int] | IndexArray) -> BoolArray:
        """(2, n): joints whose turning, and whose partial rows are equations for a model with these columns."""
        own = np.asarray(columns, dtype=np.intp)
        return np.array([rows.shown[own].any(axis=0) for rows in (self.turning, self.partial)])

    def find_row_kinds(self, columns: Sequence[int] | IndexArray) -> tuple[bool, bool]:
        """Whether turning, and whether partial rows of any joint are equations for a model with these columns."""
        turns, starts = self.select_joints(columns)
        return bool(turns.any()), bool(starts.any())

    def _combine_rows(self, used: BoolArray) -> Products:
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


def gather_products(
    observation: Observation,
    signals: Signals,
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    n_base: int,
    progress: Progress = ignore_progress,
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
    frictional = find_joints_with_friction(observation, n_base)
    width = compute_smear_width(preprocessing, recordings[0].sampling_rate)
    total = sum(compute_used_duration(recording) for recording in recordings)
    usual = max(_FINER * choose_block_length(recordings), total / _MOST)
    repeats = [find_periods(recording) for recording in recordings]
    n_periodic = sum(1 + MANY * len(periods) for each in repeats for periods in each)
    stretches = BlockNumbering(usual, _LONG * width)
    collected = RowAccumulator([len(columns) for _, columns in layout], _KINDS, int(total / usual) + n_periodic)
    done, free = 0.0, np.ones(n, dtype=bool)
    for recording, periods in zip(recordings, repeats, strict=True):
        phases = RowPhases.from_recording(observation, recording, preprocessing, n_base).with_friction_of(frictional)
        free &= phases.free
        if samples_of is None:
            samples_of_recording: Iterable[FilteredSamples] = stream_filtered_samples(
                observation, recording, preprocessing, reference, phases=phases
            )
        else:
            samples_of_recording = samples_of(recording)
        segment = -1
        for samples in samples_of_recording:
            if samples.segment != segment:
                segment = samples.segment
                stretches.begin_run(recording.name_segment(segment), periods[segment])
            phase = phases.phases_at(segment, samples.t)
            partial_rows = phases.find_partial_rows(segment, samples.t, phase, samples.held)
            collected.push(
                stretches.number_times(samples.t),
                samples.stack_equations(layout),
                (phase == Phase.MOVING, phase == Phase.REVERSING, partial_rows),
            )
            progress(min(1.0, (done + samples.t[-1] - recording.segments[0].start_time) / total), recording.name)
        done += compute_used_duration(recording)
    starts = shows_at_starts(observation)
    turns = _find_memory_columns(observation, signals) | (starts & free)
    run = stretches.list_runs()
    (stacks, counts), turning, partial = collected.finish(len(run))
    position = tuple(_locate_columns(columns, observation.n_columns) for _, columns in layout)
    moving = Products(tuple((stack,) for stack in stacks), position, counts, run)
    return PhasedProducts(moving, ConditionalRows(*turning, turns), ConditionalRows(*partial, starts))


def _locate_columns(columns: IndexArray, count: int) -> IndexArray:
    """(count,): where each of all columns stands among those that a joint has, -1 where it lacks it."""
    where = np.full(count, -1, dtype=np.intp)
    where[columns] = np.arange(len(columns))
    return where


def _find_memory_columns(observation: Observation, signals: Signals) -> BoolArray:
    """(columns, n): which columns are functions of a joint's path."""
    has_memory = np.zeros((observation.n_columns, observation.robot.n), dtype=bool)
    if observation.memory:
        for k, column in enumerate(observation.columns):
            for signal in signals.find_memory_signals(column.torque):
                has_memory[k, list(observation.robot.get_position_movers(signal.joint))] = True
    return has_memory
