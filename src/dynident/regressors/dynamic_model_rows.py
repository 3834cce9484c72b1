"""Rows of the dynamic model: W evaluated at the full rate, then filtered and decimated like Y (§12.4)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dynident.array_types import BoolArray, FloatArray, IndexArray
from dynident.effects import ReferenceParameters, RunSignal, get_effect
from dynident.effects.hysteresis_states import MemoryStates
from dynident.estimation import Reduction, merge_row_groups
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording, SampleBlock
from dynident.recordings.joint_phases import Phase, PhaseArray
from dynident.recordings.low_pass_decimation import filter_in_parallel
from dynident.recordings.low_pass_decimation import low_pass_samples as low_pass_samples
from dynident.recordings.low_pass_decimation import stream_samples as stream_samples
from dynident.regressors.model_structure import is_in_run
from dynident.regressors.observation_matrix import FurtherSignals, Observation, RegressorInputs
from dynident.regressors.qr_accumulation import MOST_VALUES, EquationRows, RestRows, accumulate_equations
from dynident.regressors.row_phases import RowPhases, changes_at_rest, is_fitted
from dynident.robot.contacts import Mixing, find_mixed_joints, yield_mixing_matrices


@dataclass(frozen=True, eq=False)
class FilteredSamples:
    """Decimated rows of one segment.

    Parameters
    ----------
    t : (m,)
        Times, s.
    values : (m, k)
        Entries of W.
    tau : (m, n)
        Torque, N m or N.
    segment : int
        Number of the segment.
    at_rest : (m, r), optional
        Entries of friction where a joint is about to move, if requested.
    held : (m, n), optional
        Where instants were taken out before the filter: share of what is under the filter at which each equation held.
    whole : tuple of (m, p_j + 1)
        [W | Y] of every joint with its halts, for rows at rest; None for joints that no instant was taken out of.
    """

    t: FloatArray
    values: FloatArray
    tau: FloatArray
    segment: int
    at_rest: FloatArray | None = None
    held: FloatArray | None = None
    whole: tuple[FloatArray | None, ...] = ()

    def split(self, time: float) -> tuple[FilteredSamples, FilteredSamples]:
        """Return the rows up to a time, and those after it."""
        count = int(np.searchsorted(self.t, time, side="right"))
        return self.select(slice(count)), self.select(slice(count, None))

    def select(self, rows: slice) -> FilteredSamples:
        """Return these rows alone."""
        return FilteredSamples(
            self.t[rows],
            self.values[rows],
            self.tau[rows],
            self.segment,
            None if self.at_rest is None else self.at_rest[rows],
            None if self.held is None else self.held[rows],
            tuple(None if own is None else own[rows] for own in self.whole),
        )

    def stack_columns(self, layout: Sequence[tuple[IndexArray, IndexArray]]) -> Iterator[FloatArray]:
        """Yield [W | Y] (p_j + 1, m) of every joint, column by column."""
        # One transposition for all joints: whole columns are then copied ten times as fast as single numbers.
        entries = np.ascontiguousarray(self.values.T)
        for j, (places, _) in enumerate(layout):
            yield np.concatenate([entries[places], self.tau[:, j][None]])

    def stack_equations(self, layout: Sequence[tuple[IndexArray, IndexArray]]) -> list[FloatArray]:
        """Return [W | Y] (m, p_j + 1) of every joint, from the places and columns of its entries."""
        equations = [np.empty((len(self.t), len(places) + 1)) for places, _ in layout]
        for j, own in enumerate(equations):
            # More than twice as fast as an index.
            np.take(self.values, layout[j][0], axis=1, out=own[:, :-1], mode="clip")
            own[:, -1] = self.tau[:, j]
        return equations


class SampleFunction:
    """Evaluates an observation matrix along a recording, with hysteresis states carried from block to block.

    Parameters
    ----------
    observation : Observation
        The matrix to evaluate.
    reference : ReferenceParameters
        What torque is predicted with.
    recording : Recording
        The recording that blocks come from, in order.
    phases : RowPhases, optional
        Take what holds joints at rest out of the equations of others that contain it.
    """

    def __init__(
        self,
        observation: Observation,
        reference: ReferenceParameters,
        recording: Recording,
        phases: RowPhases | None = None,
    ) -> None:
        self._observation = observation
        self._reference = reference
        self._recording = recording
        self._phases = phases
        self._memory = MemoryStates(observation.memory)
        self._mixing: tuple[SampleBlock, list[Mixing]] | None = None

    def __call__(self, block: SampleBlock) -> FloatArray:
        """Return entries (m, number of entries); zero outside the used samples, where the value does not matter."""
        out = np.empty((len(block.t), len(self._observation.entry_rows)))
        self.fill(block, out)
        return out

    def fill(self, block: SampleBlock, out: FloatArray) -> None:
        """Put the entries of a block of samples into an array.

        Parameters
        ----------
        block : SampleBlock
            The next block of filtered positions.
        out : (m, number of entries)
            Where to put them.
        """
        # What path led to the beginning of a segment is not known: hysteresis begins relaxed.
        if block.starts_segment:
            self._memory.restart()
        states = self._memory.push(self._observation.robot.positions(block.q))
        # Hysteresis remembers all samples; W itself is evaluated only from the first used sample to the last.
        part = _find_used_part(block)
        out[: part.start] = 0.0
        out[part.stop :] = 0.0
        if part.stop:
            # Before the rows are evaluated: an open loop would give numbers, but of no machine.
            if self._observation.robot.linkage is not None:
                self._observation.robot.linkage.check_closed(block.t[part], block.q[part])
            runs = [is_in_run(signal, self._recording, block.segment) for signal in self._observation.runs]
            reference = self._reference.add_carried(
                lambda labels: bool(is_in_run(RunSignal(labels), self._recording, block.segment))
            )
            self._observation.evaluate(
                block.q[part],
                block.dq[part],
                block.ddq[part],
                reference=reference,
                memory=states[part],
                further=FurtherSignals(
                    dddq=block.dddq[part],
                    ddddq=block.ddddq[part],
                    time=block.t[part],
                    temperature=None if block.temperature is None else block.temperature[part],
                    runs=np.array(runs),
                    period=self._recording.period,
                ),
                out=out[part],
                mixing=self._list_mixing(block) if self._observation.robot.contacts else None,
            )

    def read_torque(self, block: SampleBlock) -> FloatArray:
        """Return the torque (m, n) of a block of samples, without that of joints at rest as in the entries."""
        tau, part = block.tau.copy(), _find_used_part(block)
        if self._phases is not None and self._observation.robot.contacts:
            mixed = np.flatnonzero(find_mixed_joints(self._observation.robot))
            for some, _, elimination in self._list_mixing(block):
                if elimination is not None:
                    own = tau[part][some]
                    own[:, mixed] = (elimination @ own[:, mixed, None])[:, :, 0]
        return tau

    def _list_mixing(self, block: SampleBlock) -> list[Mixing]:
        """Return how contacts mix the equations at the used samples of a block: alike for entries and torques."""
        if self._mixing is None or self._mixing[0] is not block:
            part, unknown = _find_used_part(block), None
            if self._phases is not None:
                unknown = self._phases.find_unknown_torques(block.segment, block.t[part]) & block.used[part, None]
            # Where the torques were projected: by filtered positions, a foot would be lifted earlier or later.
            q = block.q if block.measured_q is None else block.measured_q
            self._mixing = block, list(yield_mixing_matrices(self._observation.robot, q[part], unknown))
        return self._mixing[1]


def _find_used_part(block: SampleBlock) -> slice:
    """Return the samples from the first used one to the last."""
    used = np.flatnonzero(block.used)
    return slice(int(used[0]), int(used[-1]) + 1) if len(used) else slice(0, 0)


def stream_filtered_samples(
    observation: Observation,
    recording: Recording,
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    at_rest: Observation | None = None,
    phases: RowPhases | None = None,
    segments: Sequence[int] | None = None,
) -> Iterator[FilteredSamples]:
    """Stream the entries of W, and Y with them, through the parallel filter; only rows that are used come out.

    A joint's equation holds at every instant at which it moves, and friction has a certain sign. With all other
    instants set to zero on both sides it holds at all, and the filter leaves it true: rows near a halt then tell of
    the motion in them, where the friction at rest, which nobody knows, would have been smeared over them.

    Parameters
    ----------
    observation : Observation
        The matrix W to evaluate.
    recording : Recording
        The data.
    preprocessing : Preprocessing
        Filters, differentiation and decimation.
    reference : ReferenceParameters
        What torque is predicted with.
    at_rest : Observation, optional
        Friction at the point of moving, whose entries are to come with them.
    phases : RowPhases, optional
        Takes halts out of the equations of joints that are looked at where they start, and out of all others the
        instants at which the sign of friction is uncertain.
    segments : sequence of int, optional
        Which segments, by index; all by default.

    Yields
    ------
    FilteredSamples
        Without rows where a recording under way has none for now.
    """
    function = SampleFunction(observation, reference, recording, phases)
    resting_function = None if at_rest is None else SampleFunction(at_rest, reference, recording)
    layout = [observation.joint_entries(joint) for joint in range(recording.n)]
    nowhere = np.zeros(recording.n, dtype=bool)
    starting, interrupted = (nowhere, nowhere) if phases is None else (phases.starting, phases.interrupted_joints)
    # What is filtered a second time, with the halts in it: entries of joints that have some, and their torque.
    # Rows at rest need the halts that the filtered equation lacks.
    joints = np.flatnonzero(starting) if at_rest is not None else np.zeros(0, dtype=np.intp)
    again = np.flatnonzero(np.isin(observation.entry_rows, joints))
    # All that is filtered alike lies in one matrix: its columns are these slices.
    entries, resting, tau, held, whole, torque = _allocate_slices(
        len(observation.entry_rows),
        0 if at_rest is None else len(at_rest.entry_rows),
        recording.n,
        recording.n if interrupted.any() else 0,
        len(again),
        len(joints),
    )

    # Places of an equation's entries and torque, and those of its friction at rest with them.
    equations = [np.append(places, tau.start + joint) for joint, (places, _) in enumerate(layout)]
    equations_and_rest = equations
    if at_rest is not None:
        friction = [[at_rest.joint_entries(row)[0] for row in (j, recording.n + j)] for j in range(recording.n)]
        equations_and_rest = [
            np.concatenate([torque_places, resting.start + np.concatenate(own)])
            for torque_places, own in zip(equations, friction, strict=True)
        ]

    # One pass for all columns: what belongs to one equation has to be filtered with the same instants left out.
    def values(block: SampleBlock) -> FloatArray:
        rows = np.empty((len(block.t), torque.stop))
        function.fill(block, rows[:, entries])
        if resting_function is not None:
            resting_function.fill(block, rows[:, resting])
        rows[:, tau] = function.read_torque(block)
        certain = (
            None if phases is None or not interrupted.any() else phases.find_certain_samples(block.segment, block.t)
        )
        if certain is not None:
            _zero_equations(rows, ~certain, equations_and_rest)
        # Copied before halts are taken out of the equations: the copy keeps them, for rows at rest.
        rows[:, whole], rows[:, torque] = rows[:, again], rows[:, tau.start + joints]
        if phases is not None and certain is not None:
            moves = phases.find_valid_samples(block.segment, block.t)
            _zero_equations(rows, ~moves, equations)
            rows[:, held] = certain & moves
        return rows

    width = max(torque.stop, 2 * recording.n**2 * bool(observation.robot.contacts))  # Two matrices a sample are kept.
    for segment, t, rows in filter_in_parallel(recording, preprocessing, values, segments, width):
        if not len(t):
            yield FilteredSamples(t, rows, rows, segment)
            continue
        yield FilteredSamples(
            t,
            rows[:, entries],
            rows[:, tau],
            segment,
            at_rest=None if at_rest is None else rows[:, resting],
            held=rows[:, held] if interrupted.any() else None,
            whole=_collect_unmasked(rows[:, whole], rows[:, torque], again, joints, layout),
        )


def stream_behind_kept_rows(
    observation: Observation, inputs: RegressorInputs, recording: Recording, phases: RowPhases | None = None
) -> Iterator[FilteredSamples]:
    """Stream filtered samples as `stream_filtered_samples` does; of leading columns those that an earlier pass kept.

    Filters act on every column by itself, so that what was put behind a model is evaluated and filtered alone.

    Parameters
    ----------
    observation : Observation
        The matrix W to evaluate.
    inputs : RegressorInputs
        Filters, what torque is predicted with, and the rows that are kept.
    recording : Recording
        The data.
    phases : RowPhases, optional
        Which instants are left out; by default those that the friction in W asks for.
    """
    phases = phases or RowPhases.from_recording(observation, recording, inputs.preprocessing)
    stream = partial(stream_filtered_samples, reference=inputs.reference, phases=phases)
    store, parts, most = inputs.kept_rows, observation.parts, MOST_VALUES * inputs.preprocessing.decimation
    if store is None or parts is None or recording.n_samples * len(parts[0].entry_rows) > most:
        yield from stream(observation, recording, inputs.preprocessing)
        return
    first, behind = parts
    effects = [get_effect(column.effect) for column in first.columns if column.effect]
    predicts = any(effect.needs_load or effect.first_order for effect in effects)
    reference = inputs.reference.to_vector(first.robot).tobytes() if predicts else b""
    key = (first, recording, inputs.preprocessing, phases.left_out, reference)
    rows = store.get(key)
    if rows is not None:
        for samples in stream(behind, recording, inputs.preprocessing):
            leading, rows = rows[: len(samples.t)], rows[len(samples.t) :]
            yield replace(samples, values=np.hstack([leading, samples.values]))
        return
    pieces = [np.empty((0, len(first.entry_rows)))]
    for samples in stream(observation, recording, inputs.preprocessing):
        pieces.append(samples.values[:, : len(first.entry_rows)].copy())
        yield samples
    # Only older rows of the same recording make room: passes would else remove in turn what the next one asks for.
    older = [other for other in list(store) if other[1] is recording]
    while (full := sum(map(np.size, [*pieces, *list(store.values())])) > MOST_VALUES) and older:
        store.pop(older.pop(0), None)
    if not full:
        store[key] = np.concatenate(pieces)


def _zero_equations(rows: FloatArray, out: BoolArray, places: Sequence[IndexArray]) -> None:
    """Set an equation, at `places` of `rows` (m, k), to zero at the samples where `out` (m, n) is true."""
    for joint in np.flatnonzero(out.any(axis=0)):
        rows[np.ix_(np.flatnonzero(out[:, joint]), places[int(joint)])] = 0.0


def _allocate_slices(*widths: int) -> list[slice]:
    """Return slices of so many columns each, one behind the other."""
    ends = np.cumsum(widths)
    return [slice(int(end) - width, int(end)) for end, width in zip(ends, widths, strict=True)]


def _collect_unmasked(
    rows: FloatArray,
    tau: FloatArray,
    entries: IndexArray,
    joints: IndexArray,
    layout: Sequence[tuple[IndexArray, IndexArray]],
) -> tuple[FloatArray | None, ...]:
    """Return [W | Y] of the joints in `joints`, whose `entries` were filtered with their halts; None for others."""
    equations: list[FloatArray | None] = [None] * len(layout)
    for number, joint in enumerate(joints):
        equations[joint] = np.hstack([rows[:, np.searchsorted(entries, layout[joint][0])], tau[:, [number]]])
    return tuple(equations)


def reduce_recordings(
    observation: Observation,
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    samples_of: Callable[[Recording], Iterable[FilteredSamples]] | None = None,
    at_rest: Observation | None = None,
    *,
    by_phase: bool = False,
    by_time: bool = True,
) -> Reduction:
    """Accumulate all recordings in triangular factors, one for each joint and block of time; W is never stored.

    Where a joint with friction stands, its own rows are no equations and are left out.

    Parameters
    ----------
    observation : Observation
        W, whose columns become the reduction's.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Hears of the share that is done.
    samples_of : function, optional
        Gives a recording's filtered samples, where they are at hand.
    at_rest : Observation, optional
        The friction of the same columns at rest: what is left out is then kept beside the factors.
    by_phase : bool
        Whether rows at reversals and beside halts are kept apart; with `at_rest` they always are.
    by_time : bool
        Whether there is a factor for each block of time, or only one for each segment.

    Returns
    -------
    Reduction
        One equation a joint.
    """
    keeps_rest_rows = at_rest is not None
    if samples_of is None and not keeps_rest_rows:
        samples_of = partial(stream_behind_kept_rows, observation, inputs)
    splits_phases = by_phase or keeps_rest_rows
    rows_of = ObservationRows(observation, inputs.preprocessing, inputs.reference, samples_of, at_rest, splits_phases)
    columns = [observation.joint_entries(joint)[1] for joint in range(observation.robot.n)] * (
        3 if splits_phases else 1
    )
    reduction = accumulate_equations(
        rows_of, columns, observation.n_columns, inputs.recordings, progress, keeps_rest_rows, by_time=by_time
    )
    return merge_row_groups(reduction) if splits_phases else reduction


@dataclass(frozen=True, eq=False)
class ObservationRows:
    """Makes the equations of a recording, one a joint, as `reduce_recordings` says.

    With `by_phase` there are three equations a joint: n of the rows where it moves, n of its reversals, and n of the
    rows beside its halts.
    """

    observation: Observation
    preprocessing: Preprocessing
    reference: ReferenceParameters
    samples_of: Callable[[Recording], Iterable[FilteredSamples]] | None = None
    at_rest: Observation | None = None
    by_phase: bool = False

    def __call__(self, recording: Recording) -> Iterator[EquationRows]:
        """Yield the rows of a recording."""
        observation, joints = self.observation, range(self.observation.robot.n)
        layout = [observation.joint_entries(joint) for joint in joints]
        resting = None if self.at_rest is None else RestRowBuilder(observation, self.at_rest)
        phases = RowPhases.from_recording(observation, recording, self.preprocessing)
        if self.samples_of is None:
            sample_blocks: Iterable[FilteredSamples] = stream_filtered_samples(
                observation, recording, self.preprocessing, self.reference, self.at_rest, phases
            )
        else:
            sample_blocks = self.samples_of(recording)
        for samples in sample_blocks:
            rows = samples.stack_equations(layout)
            phase = phases.phases_at(samples.segment, samples.t)
            partial = phases.find_partial_rows(samples.segment, samples.t, phase, samples.held)
            rest_rows = None
            if resting is not None and samples.at_rest is not None:
                rest_rows = [resting.build_rest_rows(joint, rows[joint], samples, phase) for joint in joints]
            used = is_fitted(phase) | partial
            if self.by_phase:
                turns = phase == Phase.REVERSING
                # The same rows three times, of which each equation uses other ones.
                rows, used = rows * 3, np.hstack([used & ~turns & ~partial, used & turns, partial])
            yield EquationRows(samples.t, rows, samples.segment, used, rest_rows)


class RestRowBuilder:
    """Makes rows of W at rest, for either direction, from W's entries and those of friction about to move.

    Parameters
    ----------
    observation : Observation
        The matrix W.
    at_rest : Observation
        Friction of the same columns about to move, from `build_rest_observation`.
    """

    def __init__(self, observation: Observation, at_rest: Observation) -> None:
        n = observation.robot.n
        changed = changes_at_rest(at_rest)
        self._changed = [changed[observation.joint_entries(j)[1]] for j in range(n)]
        self._columns = [observation.joint_entries(j)[1] for j in range(n)]
        self._entries = [[at_rest.joint_entries(row) for row in (j, n + j)] for j in range(n)]

    def build_rest_rows(self, joint: int, rows: FloatArray, samples: FilteredSamples, phase: PhaseArray) -> RestRows:
        """Return the rows at rest of one joint from its rows [W | Y] (m, p + 1)."""
        standing = phase[:, joint] == Phase.STANDING
        unmasked = samples.whole[joint] if samples.whole else None
        whole = rows if unmasked is None else unmasked
        either = []
        for positions, columns in self._entries[joint]:
            # Friction as filtered is that of a joint that moves. It is replaced by that of a joint about to move, one
            # way and then the other; all other columns are the same at rest.
            w = whole[standing, :-1].copy()
            w[:, self._changed[joint]] = 0.0
            if samples.at_rest is not None:
                w[:, np.searchsorted(self._columns[joint], columns)] = samples.at_rest[standing][:, positions]
            either.append(w)
        return RestRows(either[0], either[1], whole[standing, -1])
