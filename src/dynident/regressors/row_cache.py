"""Keep filtered rows of W in memory, so that an extension evaluates only new columns."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.effects import Column, ReferenceParameters
from dynident.estimation import Reduction
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.dynamic_model_rows import FilteredSamples, reduce_recordings, stream_filtered_samples
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.qr_accumulation import MOST_VALUES, compute_used_duration
from dynident.regressors.row_phases import RowPhases, have_same_instants


@dataclass(frozen=True, eq=False)
class CachedRows:
    """Filtered samples of recordings, as they left the filter, for one observation matrix.

    Parameters
    ----------
    observation : Observation
        The matrix W whose entries are cached.
    reference : ReferenceParameters or None
        What loads were predicted with; None where no column needs a load.
    preprocessing : Preprocessing
        Filters that the rows passed.
    recordings : tuple of Recording
        The recordings that the rows are of.
    samples : tuple of tuple of FilteredSamples
        Filtered rows of every recording, piece by piece.
    """

    observation: Observation
    reference: ReferenceParameters | None
    preprocessing: Preprocessing
    recordings: tuple[Recording, ...]
    samples: tuple[tuple[FilteredSamples, ...], ...]

    def __repr__(self) -> str:
        return f"KeptRows({', '.join(recording.name for recording in self.recordings)})"

    def find_samples(self, recording: Recording, preprocessing: Preprocessing) -> tuple[FilteredSamples, ...] | None:
        """Return the cached samples of a recording.

        Parameters
        ----------
        recording : Recording
            The recording, or another object with the same rows.
        preprocessing : Preprocessing
            Filters that the rows have to have passed.

        Returns
        -------
        tuple of FilteredSamples or None
            None if there are none, or of another preprocessing.
        """
        if preprocessing != self.preprocessing:
            return None
        for kept_recording, samples in zip(self.recordings, self.samples, strict=True):
            if _is_same_recording(kept_recording, recording):
                return samples
        return None


def reduce_and_cache(
    model: Model,
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
) -> tuple[Reduction, CachedRows | None]:
    """Reduce recordings to a model's columns, and cache their filtered rows where they are few.

    Parameters
    ----------
    model : Model
        Its columns become the reduction's.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Hears of the share that is done.
    known : CachedRows, optional
        Of a model that this one extends: only the columns behind it are evaluated, unless loads are predicted anew.

    Returns
    -------
    reduction : Reduction
        The equations of the model's columns.
    rows : CachedRows or None
        None if the rows have more than `MOST_VALUES` entries.
    """
    observation = model.observation
    usable = known if known is not None and _is_extension(observation, inputs.reference, known) else None
    if _bound_values(observation, inputs.recordings, inputs.preprocessing) > MOST_VALUES:
        samples_of = _make_sample_reader(usable, observation, model.at_rest, inputs.preprocessing, inputs.reference)
        return reduce_recordings(observation, inputs, progress, samples_of, model.at_rest), None
    samples_by_recording: dict[Recording, tuple[FilteredSamples, ...]] = {}

    def cache_samples(recording: Recording) -> Iterator[FilteredSamples]:
        collected = []
        for samples in _read_samples(
            observation, model.at_rest, recording, inputs.preprocessing, inputs.reference, usable
        ):
            # Samples are cached while they pass on to the reduction, so that nothing is read twice.
            collected.append(samples)
            yield samples
        samples_by_recording[recording] = tuple(collected)

    reduction = reduce_recordings(observation, inputs, progress, cache_samples, model.at_rest)
    load_reference = inputs.reference if model.needs_load else None
    # The reduction may have worked through the recordings in another order.
    samples = tuple(samples_by_recording[recording] for recording in inputs.recordings)
    return reduction, CachedRows(observation, load_reference, inputs.preprocessing, tuple(inputs.recordings), samples)


def reduce_with_columns(
    model: Model,
    more: Sequence[Column],
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
    *,
    by_time: bool = True,
) -> Reduction:
    """Reduce recordings to a model's columns and further ones, without the rows near halts and at rest.

    Parameters
    ----------
    model : Model
        The model whose columns come first.
    more : sequence of Column
        Further columns, made from the model's signals.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Hears of the share that is done.
    known : CachedRows, optional
        Of the model: only the columns behind it are evaluated.
    by_time : bool
        Whether there is a factor for each block of time; without, the sums over all of them take half the time.

    Returns
    -------
    Reduction
        The equations of the model's columns and, behind them, of the further ones.
    """
    observation = model.observation.extend(more, model.signals)
    return reduce_without_rest(observation, inputs, progress, known, by_time=by_time)


def reduce_without_rest(
    observation: Observation,
    inputs: RegressorInputs,
    progress: Progress = ignore_progress,
    known: CachedRows | None = None,
    *,
    by_time: bool = True,
) -> Reduction:
    """Reduce recordings to the columns of W, without the rows near halts and at rest, which take no part in a fit.

    Parameters
    ----------
    observation : Observation
        The matrix W.
    inputs : RegressorInputs
        Recordings, their filters, and what torque is predicted with.
    progress : Progress
        Hears of the share that is done.
    known : CachedRows, optional
        Of leading columns: only those behind them are evaluated.
    by_time : bool
        Whether there is a factor for each block of time.
    """
    usable = known if known is not None and _is_extension(observation, inputs.reference, known) else None
    samples_of = _make_sample_reader(usable, observation, None, inputs.preprocessing, inputs.reference)
    return reduce_recordings(observation, inputs, progress, samples_of, by_phase=True, by_time=by_time)


def _bound_values(observation: Observation, recordings: Sequence[Recording], preprocessing: Preprocessing) -> float:
    """Return an upper bound of the number of entries in the filtered rows."""
    seconds = sum(compute_used_duration(recording) * recording.sampling_rate for recording in recordings)
    return seconds / preprocessing.decimation * (len(observation.entry_rows) + observation.robot.n)


def _make_sample_reader(
    known: CachedRows | None,
    observation: Observation,
    at_rest: Observation | None,
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
) -> Callable[[Recording], Iterator[FilteredSamples]] | None:
    """Return the function that gives a recording's samples, with the help of cached ones; None without any."""
    if known is None:
        return None
    return lambda recording: _read_samples(observation, at_rest, recording, preprocessing, reference, known)


def _read_samples(
    observation: Observation,
    at_rest: Observation | None,
    recording: Recording,
    preprocessing: Preprocessing,
    reference: ReferenceParameters,
    known: CachedRows | None,
) -> Iterator[FilteredSamples]:
    if known is not None and known.observation is observation:
        samples = known.find_samples(recording, preprocessing)
        if samples is not None:
            yield from samples
            return
    # The cached leading columns (head), and the new ones behind them (tail).
    head = None if known is None else known.find_samples(recording, preprocessing)
    phases = RowPhases.from_recording(observation, recording, preprocessing)
    if head is None or observation.parts is None:
        yield from stream_filtered_samples(observation, recording, preprocessing, reference, at_rest, phases)
        return
    # Filters act on every column by itself: the new ones can be put behind the cached ones. Both are as many rows, but
    # of many columns fewer samples are filtered at once.
    tail = stream_filtered_samples(observation.parts[1], recording, preprocessing, reference, at_rest, phases)
    cached = deque(samples for samples in head if len(samples.t))
    for behind in tail:
        if not len(behind.t):
            yield behind
            continue
        before = _take_rows(cached, len(behind.t))
        whole = tuple(
            None
            if new is None or cached_rows[0] is None
            else np.hstack([np.concatenate([w[:, :-1] for w in cached_rows]), new])
            for cached_rows, new in zip(zip(*(part.whole for part in before), strict=True), behind.whole, strict=True)
        )
        values = np.concatenate([part.values for part in before])
        yield replace(behind, values=np.hstack([values, behind.values]), whole=whole)


def _take_rows(cached: deque[FilteredSamples], count: int) -> list[FilteredSamples]:
    """Take so many rows from the front of cached samples, however these were cut."""
    parts = []
    while count:
        first = cached.popleft()
        parts.append(first.select(slice(0, count)))
        if len(first.t) > count:
            cached.appendleft(first.select(slice(count, None)))
        count -= len(parts[-1].t)
    return parts


def _is_extension(observation: Observation, reference: ReferenceParameters, known: CachedRows) -> bool:
    """Return whether the cached rows are those of the leading columns, or all, with the same instants left out."""
    if observation is known.observation:
        return known.reference is None or reference.equals(known.reference)
    if observation.parts is None or observation.parts[0] is not known.observation:
        return False
    # More friction takes more instants out before the filter, which changes every column's filtered rows.
    if not have_same_instants(observation, known.observation):
        return False
    return known.reference is None or reference.equals(known.reference)


def _is_same_recording(first: Recording, second: Recording) -> bool:
    """Return whether two recordings have the same rows, though they may be different objects."""
    if (first.windows, first.segments, first.name, first.payload) != (
        second.windows,
        second.segments,
        second.name,
        second.payload,
    ):
        return False
    return first.source is second.source or (first.path is not None and first.path == second.path)
