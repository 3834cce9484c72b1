"""Identify from a recording while it is made: a square-root information filter on triangular factors.

New samples are filtered as far as no later sample can change them, evaluated, and folded into the same factors as in a
batch. An estimate is a small solution of these factors. Once the recording has ended, the model is that of `identify`.
"""

from __future__ import annotations

import hashlib
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from dynident.effects import ReferenceParameters, get_effect
from dynident.errors import DynidentError
from dynident.estimation import (
    Errors,
    FactorAccumulator,
    Reduction,
    compute_errors,
    concatenate_reductions,
    merge_row_groups,
)
from dynident.identification.description_prior import check_known
from dynident.identification.equations.model_and_data_checks import (
    check_joint_torques,
    check_recordings,
    check_reduction,
    check_runs,
    check_temperature,
)
from dynident.identification.equations.reduced_recordings import Data, ReducedData
from dynident.identification.estimation_problem import Problem
from dynident.identification.identification_choices import IdentificationChoices
from dynident.identification.identified_models.fit_model import identify_model
from dynident.identification.identified_models.identification_result import Estimate, LiveEstimate, RowsInMemory
from dynident.identification.identified_models.identify_from_recordings import (
    complete_identification,
    identify,
    mark_unrecorded_torques,
)
from dynident.identification.shape_search import lacks_shape
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, choose_preprocessing
from dynident.recordings.recording import Segment, StoredRows
from dynident.regressors.dynamic_model_rows import FilteredSamples, ObservationRows, stream_filtered_samples
from dynident.regressors.model_structure import Model, build_model
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.qr_accumulation import MOST_VALUES, choose_block_length
from dynident.regressors.row_cache import CachedRows
from dynident.regressors.row_phases import RowPhases
from dynident.robot import Robot

MOST_BLOCKS = 48
"""Blocks of time that have factors of their own; of more, neighbours are joined, so that an estimate stays cheap."""

CONTEXT = 5.0
"""Seconds before new rows in which standstills are looked for: longer than any filter, and than most halts."""

_READ = 8192
_BLOCK_SHARE, _AGES = 0.1, 7.0
"""Length of a block of time over the memory, and age over the memory at which a block is dropped."""
_NO_ROWS = "No row is complete yet: the filters look ahead."
_GROWTH, _MOVED = 2.0, 0.1
"""Times as long a recording has to be before its filters are chosen anew; periods by which rows may move that are read
again, as a better known sampling rate moves them."""


class _GrowingRows:
    """Source of one segment's rows, which come while they are read; an empty block where there are no more for now."""

    def __init__(self) -> None:
        self.is_ended = False
        self._rows: deque[StoredRows] = deque()
        self._nothing: StoredRows | None = None

    def append(self, rows: StoredRows) -> None:
        """Add rows at the end."""
        self._rows.append(rows)
        self._nothing = StoredRows._make(None if values is None else values[:0] for values in rows)

    def rows(self, first: int, length: int, block_length: int) -> Iterator[StoredRows]:
        """Yield all rows, however many are asked for: nobody knows yet how many there will be."""
        while self._rows or not self.is_ended:
            if self._rows:
                yield self._rows.popleft()
            elif self._nothing is not None:
                yield self._nothing


@dataclass(eq=False)
class _OpenSegment:
    """The segment that grows: how much of it was read, and the rows that its filters give."""

    index: int
    segment: Segment
    source: _GrowingRows
    samples: Iterator[FilteredSamples]
    n_read: int = 0
    last_time: float = -np.inf
    digest: Any = field(default_factory=hashlib.blake2b)

    def is_begun_by(self, segment: Segment) -> bool:
        """Return whether a segment of the recording, read again, begins with the rows that were read of this one."""
        places = [(item.first_row, item.start_time, item.label) for item in (self.segment, segment)]
        # One that has ended cannot grow any more.
        is_long_enough = segment.length == self.n_read if self.source.is_ended else segment.length >= self.n_read
        return places[0] == places[1] and is_long_enough


class RecursiveIdentification:
    """Identifies the base parameters of a robot from one recording while it grows.

    The positions' filter has no phase lag and looks a second or two ahead: an estimate rests on the samples up to then,
    and the last ones follow in `finish`. Provisional until then are filters that were left open, and which rows count
    as standstills. Effects whose shape constants are searched for, or that need a predicted load, come in `finish`
    alone. What that gives is what `identify` gives of the whole recording.

    Parameters
    ----------
    robot : Robot
        The robot that is recorded.
    choices : IdentificationChoices, optional
        What is identified, and how. Rows are those of the dynamic model.
    memory : float, optional
        Rows count the less the older they are, exp(-age / memory), s: for parameters that change. By default all rows
        count alike. A model with forgetting is no final one.

    Raises
    ------
    DynidentError
        For another equation type, or a memory that is no positive number.
    """

    def __init__(
        self, robot: Robot, choices: IdentificationChoices | None = None, *, memory: float | None = None
    ) -> None:
        self._robot, self._choices, self._memory = robot, choices or IdentificationChoices(), memory
        if self._choices.model != "dynamic":
            raise DynidentError(
                f"a recording under way is followed with rows of the dynamic model, not of {self._choices.model}; "
                "choose dynamic, or identify once the recording has ended",
                pointer="/model",
            )
        if memory is not None and not 0.0 < memory < np.inf:
            raise DynidentError(f"memory is {memory!r}; give seconds above zero", pointer="/memory")
        self._recording: Recording | None = None
        self._rows: _FactorsOfModel | None = None
        self._seconds_at_choice = 0.0
        self._reason = "no rows yet"
        self._last: LiveEstimate | None = None

    @single_threaded
    def push(self, recording: Recording) -> None:
        """Take the recording so far; what was pushed before is not read again.

        Parameters
        ----------
        recording : Recording
            The whole recording so far, which begins as the last one did.

        Raises
        ------
        DynidentError
            Where it cannot be used with the choices at all, such as for lacking temperatures.
        """
        check_recordings(self._robot, [recording], ())
        self._recording = recording = self._hold_rate(recording)
        try:
            preprocessing = self._choose_filters(recording)
        except DynidentError as error:
            # Too short, or no joint has moved yet.
            self._reason = error.detail
            return
        rows = former = self._rows
        if rows is None or preprocessing != rows.preprocessing or not rows.is_continued_by(recording):
            self._rows = rows = _FactorsOfModel(self._robot, self._choices, recording, preprocessing, self._memory)
            rows.push(recording)
            last = self._last
            if former is None or last is None or last.estimate is None or not rows.has_columns_of(last.estimate):
                self._last = None
            else:
                # The rows of the last estimate come first, so that it predicts the new ones.
                rows.fold(until=former.last_time)
        else:
            rows.push(recording)

    def _hold_rate(self, recording: Recording) -> Recording:
        """Return the recording at the rate of the rows that were read, where it is almost the same."""
        if self._rows is None:
            return recording
        rate = self._rows.sampling_rate
        # With more rows the rate of a shaky clock is known better: its grid moves by so many periods up to the end.
        moved = abs(recording.sampling_rate / rate - 1.0) * recording.n_samples
        return replace(recording, sampling_rate=rate) if moved < _MOVED else recording

    def _choose_filters(self, recording: Recording) -> Preprocessing:
        seconds = _measure_seconds(recording)
        if self._choices.preprocessing is not None:
            return self._choices.preprocessing
        if self._rows is not None and seconds < _GROWTH * self._seconds_at_choice:
            return self._rows.preprocessing
        self._seconds_at_choice = seconds
        chosen = choose_preprocessing([recording])
        known = None if self._rows is None else self._rows.preprocessing
        # Filters that differ in their reasons alone are the same ones.
        return known if known is not None and _are_equal(known, chosen) else chosen

    @single_threaded
    def estimate(self) -> LiveEstimate:
        """Solve for the parameters by all rows so far."""
        recording, rows = self._recording, self._rows
        if recording is None or rows is None:
            seconds, count = (0.0, 0) if recording is None else (_measure_seconds(recording), recording.n_samples)
            return LiveEstimate(seconds, count, 0, None, self._reason)
        fresh, before = rows.fold(), self._last
        live = LiveEstimate(_measure_seconds(recording), recording.n_samples, 0, None, _NO_ROWS)
        remembered = rows.weighted_factors
        if remembered is not None and (fresh is not None or before is None or before.n_rows != remembered.n_rows):
            live = replace(live, n_rows=remembered.n_rows)
            try:
                estimate, fit = rows.solve(remembered)
                live = replace(live, estimate=estimate, fit=fit, reason="")
            except DynidentError as error:
                live = replace(live, reason=error.detail)
            if before is not None and before.estimate is not None and fresh is not None:
                newest = compute_errors(merge_row_groups(fresh), before.estimate.values)
                live = replace(live, predicted=newest.relative)
        elif before is not None and remembered is not None:
            # Without a new row nothing is solved anew.
            live = replace(before, seconds=live.seconds, n_samples=live.n_samples)
        self._last = live
        return live

    @single_threaded
    def finish(self, recording: Recording | None = None, progress: Progress = ignore_progress) -> LiveEstimate:
        """Return the model from the recording, which has ended: the one that `identify` gives.

        Parameters
        ----------
        recording : Recording, optional
            The whole recording; by default the one pushed last.
        progress : Progress
            Called with the fraction done and a message.

        Raises
        ------
        DynidentError
            Where the data do not determine the parameters.
        """
        whole = recording or self._recording
        if whole is None:
            raise DynidentError("nothing was recorded", title="Nothing to identify from")
        self.push(whole)
        rows, filters = self._rows, self._choices.preprocessing or choose_preprocessing([whole])
        known = None
        if rows is not None and rows.sampling_rate == whole.sampling_rate and _are_equal(rows.preprocessing, filters):
            known = rows.finish(whole)
        if rows is None or known is None:
            # Rows that were made with other filters, or with other instants left out, are made again.
            identified = identify(self._robot, [whole], (), self._choices, progress)
        else:
            identified = identify_model(
                rows.model, [whole], (), rows.choices, rows.preprocessing, rows.reference, progress, known
            )
            identified = complete_identification(self._robot, [whole], (), self._choices, identified, progress)
        n_rows, predicted = identified.data.training.n_rows, None if self._last is None else self._last.predicted
        seconds, count = _measure_seconds(whole), whole.n_samples
        return LiveEstimate(seconds, count, n_rows, identified.estimate, "", identified.fit, predicted, identified)


class GrowingFactors:
    """Rows of one recording in the columns of an observation matrix, as they come, and their triangular factors.

    Parameters
    ----------
    observation, at_rest : Observation
        The matrix W; friction of the same columns about to move, where its rows are to be kept.
    inputs : RegressorInputs
        The recording so far, its filters, and what torque is predicted with.
    memory : float, optional
        Rows count the less the older they are, exp(-age / memory), s.
    """

    def __init__(
        self, observation: Observation, at_rest: Observation | None, inputs: RegressorInputs, memory: float | None
    ) -> None:
        (self._recording,) = inputs.recordings
        self.sampling_rate = self._recording.sampling_rate
        self.preprocessing, self.reference = inputs.preprocessing, inputs.reference
        self._observation, self._at_rest, self._memory = observation, at_rest, memory
        self.reduction: Reduction | None = None
        self._open: _OpenSegment | None = None
        self._done: list[_OpenSegment] = []
        self._new: list[FilteredSamples] = []
        self._kept: list[FilteredSamples] = []
        self._n_kept = 0

    def is_continued_by(self, recording: Recording) -> bool:
        """Return whether a recording begins with the same segments."""
        parts = [*self._done, *([] if self._open is None else [self._open])]
        own = recording.segments
        return _describe_rows(recording) == _describe_rows(self._recording) and all(
            part.index < len(own) and part.is_begun_by(own[part.index]) for part in parts
        )

    def push(self, recording: Recording) -> None:
        """Read the rows that are new, and filter them as far as they are complete."""
        self._recording = recording
        first = self._done[-1].index + 1 if self._done else 0
        for index in range(first, len(recording.segments)):
            segment = recording.segments[index]
            if not segment.length:
                continue
            if self._open is None:
                self._open = self._open_segment(index)
            part = self._open
            part.segment = segment
            for rows in recording.source.rows(segment.first_row + part.n_read, segment.length - part.n_read, _READ):
                if len(rows.q):
                    part.digest.update(_join_signals(rows))
                    part.n_read += len(rows.q)
                    part.source.append(rows)
            if index < len(recording.segments) - 1:
                self._close_segment()
            else:
                self._drain(part)

    def _open_segment(self, index: int) -> _OpenSegment:
        source, segment = _GrowingRows(), self._recording.segments[index]
        # Its length is not known yet: the source ends where the segment does.
        segments = tuple(replace(item, length=1) for item in self._recording.segments)
        growing = replace(self._recording, source=source, segments=segments)
        samples = stream_filtered_samples(
            self._observation, growing, self.preprocessing, self.reference, self._at_rest, segments=[index]
        )
        return _OpenSegment(index, segment, source, samples)

    def _close_segment(self) -> None:
        if self._open is not None:
            self._open.source.is_ended = True
            self._drain(self._open)
            self.fold()
            self._done.append(self._open)
            self._open = None

    def _drain(self, part: _OpenSegment) -> None:
        for samples in part.samples:
            if not len(samples.t):
                break
            self._new.append(samples)
            self._n_kept += samples.values.size + samples.tau.size
            if self._n_kept <= MOST_VALUES:
                self._kept.append(samples)

    @property
    def last_time(self) -> float:
        """Time of the newest row in the factors, s."""
        parts = [*self._done, *([] if self._open is None else [self._open])]
        return max((part.last_time for part in parts), default=-np.inf)

    def fold(self, until: float = np.inf) -> Reduction | None:
        """Fold new rows into the factors, and return their own factors; None where there are none."""
        halves = [samples.split(until) for samples in self._new]
        part, new = self._open, [early for early, _ in halves if len(early.t)]
        if part is None or not new:
            return None
        self._new = [late for _, late in halves if len(late.t)]
        observation = self._observation
        columns = [observation.joint_entries(j)[1] for j in range(observation.robot.n)] * 3
        length = choose_block_length([self._recording])
        if self._memory is not None:
            length = min(length, _BLOCK_SHARE * self._memory)
        accumulator = FactorAccumulator(columns, observation.n_columns, length)
        window = _cut_window(self._recording, part.segment, min(part.last_time, float(new[0].t[0])) - CONTEXT)
        own = [replace(samples, segment=0) for samples in new]
        rows_of = ObservationRows(
            observation, self.preprocessing, self.reference, samples_of=lambda _: own, by_phase=True
        )
        for rows in rows_of(window):
            accumulator.push(rows.t, rows.rows, rows.used)
        part.last_time = float(new[-1].t[-1])
        fresh = accumulator.finish()
        whole = fresh if self.reduction is None else concatenate_reductions([self.reduction, fresh])
        if self._memory is not None:
            (recent,) = np.nonzero(whole.spans[:, 1] > whole.spans[-1, 1] - _AGES * self._memory)
            self.reduction = whole.select_blocks(recent.tolist())
        else:
            self.reduction = whole.merge_block_pairs() if whole.n_blocks > MOST_BLOCKS else whole
        return fresh

    @property
    def weighted_factors(self) -> Reduction | None:
        """The rows so far, one equation a joint, each with its weight; None where there are none."""
        if self.reduction is None:
            return None
        weighted = self.reduction if self._memory is None else self.reduction.forget_exponentially(self._memory)
        return merge_row_groups(weighted)


class _FactorsOfModel(GrowingFactors):
    """Rows of one recording in the columns of a model, which is solved for."""

    def __init__(
        self,
        robot: Robot,
        choices: IdentificationChoices,
        recording: Recording,
        preprocessing: Preprocessing,
        memory: float | None,
    ) -> None:
        check_joint_torques(robot, choices.model, [recording])
        # The others need a first fit without them.
        plain = tuple(e for e in choices.effects if not (get_effect(e.effect).needs_load or lacks_shape(e)))
        check_temperature(plain, [recording], ())
        check_runs(plain, [recording], ())
        marked = mark_unrecorded_torques(robot, [recording])
        # Estimators that simulate the robot need the whole recording.
        own = choices if choices.solver.from_reduced else replace(choices, estimator="wls")
        self._is_complete = len(plain) == len(choices.effects) and own is choices
        self.choices = replace(own, effects=plain)
        self.model: Model = build_model(marked, plain, tolerance=choices.tolerance)
        # The other effects have parameters of their own, which are checked once the recording has ended.
        names = choices.known if plain == choices.effects else [column.name for column in self.model.columns]
        check_known(self.model, choices.keep_known(names).known)
        inputs = RegressorInputs([recording], preprocessing, ReferenceParameters.massless(marked))
        super().__init__(self.model.observation, self.model.at_rest, inputs, memory)

    def has_columns_of(self, estimate: Estimate) -> bool:
        """Return whether an estimate is one of the same parameters."""
        own, others = ([(c.name, c.effect, c.shape) for c in model.kept] for model in (self.model, estimate.model))
        return own == others

    def solve(self, reduction: Reduction) -> tuple[Estimate, Errors]:
        """Return what these factors give, without moving bodies to where they are possible, and what it leaves."""
        equations = Data(reduction, reduction, (self._recording,), self.preprocessing, self.reference)
        problem = Problem.from_choices(self.model, self.choices, equations)
        check_reduction(self.model, reduction, problem.known)
        torque = problem.data.torque
        fitted = self.choices.plan.solve(self.choices, problem)
        reduced = ReducedData(torque, torque, None, None, self.preprocessing)
        estimate = Estimate.from_solution(self.model, reduced, self.reference, fitted.solution, fitted.statistics)
        return estimate, compute_errors(torque, estimate.values)

    def finish(self, recording: Recording) -> RowsInMemory | None:
        """Return the filtered rows of the whole recording; None where they are not all as a batch makes them."""
        self._close_segment()
        phases = RowPhases.from_recording(self.model.observation, recording, self.preprocessing)
        # With halts taken out before the filter, rows depend on halts that are known at the end alone.
        takes_halts_out = phases.interrupted_joints.any() or bool(self.model.robot.contacts)
        is_as_in_batch = self._is_complete and not takes_halts_out and self._n_kept <= MOST_VALUES
        if not is_as_in_batch or [part.digest.digest() for part in self._done] != _digest_segments(recording):
            return None
        rows = CachedRows(self.model.observation, None, self.preprocessing, (recording,), (tuple(self._kept),))
        return RowsInMemory(rows)


def _are_equal(first: Preprocessing, second: Preprocessing) -> bool:
    return replace(first, reasons=()) == replace(second, reasons=())


def _measure_seconds(recording: Recording) -> float:
    return recording.n_samples * recording.period


def _describe_rows(recording: Recording) -> tuple[object, ...]:
    """Return what all rows of a recording have in common."""
    signals = recording.has_temperature, recording.has_wrench, recording.has_command
    return recording.sampling_rate, recording.windows, recording.payload, recording.joints_without_torque, signals


def _cut_window(recording: Recording, segment: Segment, start: float) -> Recording:
    """Return a segment from a time on, as a recording of its own."""
    first = int(np.clip((start - segment.start_time) * recording.sampling_rate, 0, segment.length - 1))
    cut = replace(
        segment,
        first_row=segment.first_row + first,
        length=segment.length - first,
        start_time=segment.start_time + first * recording.period,
    )
    return replace(recording, segments=(cut,))


def _join_signals(rows: StoredRows) -> bytes:
    return np.hstack([values for values in rows if values is not None]).tobytes()


def _digest_segments(recording: Recording) -> Sequence[bytes]:
    digests = []
    for segment in recording.segments:
        if segment.length:
            digest = hashlib.blake2b()
            for rows in recording.source.rows(segment.first_row, segment.length, _READ):
                digest.update(_join_signals(rows))
            digests.append(digest.digest())
    return digests
