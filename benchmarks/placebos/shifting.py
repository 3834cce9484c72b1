"""Candidates' columns at the wrong time: filtered rows of W whose columns behind the model's are rolled within a run.

This is put between recordings and whatever folds their rows, as that one's `samples_of`; it knows nothing of how
candidates are judged.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from dynident.recordings import Recording
from dynident.regressors.dynamic_model_rows import FilteredSamples
from dynident.regressors.observation_matrix import Observation

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

ColumnKey = tuple[str, str, tuple[tuple[str, float], ...], tuple[str, ...]]
"""What tells two columns of one robot apart."""

SamplesOf = Callable[[Recording], Iterable[FilteredSamples]]
"""The filtered rows of W and Y of a recording, as `reduce_recordings` takes them."""

KindsOf = Callable[[Recording, FilteredSamples], IndexArray]
"""(m, n): the kind of every row for every joint; rows change places with rows of their own kind alone."""

# Shares of a run: clear of no shift at all, which is also one of the whole run.
_LEAST, _MOST = 0.15, 0.85
# Correlation of a run's torque with itself from which on it repeats itself, and what came later would be right again.
_ALIKE = 0.3
# Share of the shifts that are left where a run repeats itself everywhere.
_FEW = 0.1


@dataclass(frozen=True, eq=False)
class Shifts:
    """By which shares of a run columns are shifted: drawn where they are asked for the first time, then kept.

    All columns of an effect on a joint are shifted alike, whatever their shape constants: a candidate stays what it
    is, at another time.
    """

    rng: np.random.Generator
    _drawn: dict[tuple[str, str, str], float] = field(default_factory=dict)

    def share(self, effect: str, joint: str, run: str, possible: FloatArray) -> float:
        """The share of a run by which the columns of an effect on a joint are late: one of those that are possible."""
        key = (effect, joint, run)
        if key not in self._drawn:
            self._drawn[key] = float(self.rng.choice(possible))
        return self._drawn[key]


@dataclass(frozen=True, eq=False)
class ShiftedCandidates:
    """Rows of `samples_of` in which all columns but the model's `own`, by their keys, come at other times of a run."""

    observation: Observation
    own: frozenset[ColumnKey]
    samples_of: SamplesOf
    shifts: Shifts
    kinds_of: KindsOf

    def __call__(self, recording: Recording) -> Iterator[FilteredSamples]:
        """The rows of a recording, a run at a time."""
        for samples in whole_runs(self.samples_of(recording)):
            kinds = self.kinds_of(recording, samples)
            run = recording.name_segment(samples.segment)
            possible = wrong_shares(samples.tau)
            values = samples.values.copy()
            for (effect, joint, row), entries in self._groups():
                share = self.shifts.share(effect, joint, run, possible)
                values[:, entries] = rolled(values[:, entries], share, kinds[:, row])
            yield replace(samples, values=values)

    def _groups(self) -> Iterator[tuple[tuple[str, str, int], IndexArray]]:
        """Entries of W that are shifted alike and stand in the same row."""
        columns = self.observation.columns

        def key(entry: int) -> tuple[str, str, int]:
            column = columns[self.observation.entry_columns[entry]]
            return column.effect, column.link, int(self.observation.entry_rows[entry])

        entries_of = self.observation.entry_columns
        shifted = [entry for entry, k in enumerate(entries_of) if columns[k].key not in self.own]
        for which, entries in groupby(sorted(shifted, key=key), key):
            yield which, np.array(list(entries), dtype=np.intp)


def wrong_shares(tau: FloatArray) -> FloatArray:
    """Shares of a run by which it can be shifted and is then unlike itself, from its torque (m, n)."""
    spectrum = np.fft.rfft(tau - tau.mean(axis=0), axis=0)
    own = np.fft.irfft(np.abs(spectrum) ** 2, len(tau), axis=0)
    moved = own[0] > 0
    likeness = np.abs(own[:, moved] / own[0, moved]).mean(axis=1) if moved.any() else np.zeros(len(tau))
    shares = np.arange(len(tau)) / len(tau)
    inside = (shares >= _LEAST) & (shares <= _MOST)
    wrong = inside & (likeness < max(_ALIKE, float(np.quantile(likeness[inside], _FEW))))
    return shares[wrong] if wrong.any() else shares[inside]


def rolled(values: FloatArray, share: float, kinds: IndexArray) -> FloatArray:
    """Values (m, k) later by a share of all rows, each kind of rows (m,) among themselves, the last ones in front."""
    out = np.empty_like(values)
    for kind in np.unique(kinds):
        rows = np.flatnonzero(kinds == kind)
        out[rows] = np.roll(values[rows], round(share * len(rows)), axis=0)
    return out


def whole_runs(parts: Iterable[FilteredSamples]) -> Iterator[FilteredSamples]:
    """The same rows, those of a segment together."""
    for segment, group in groupby(parts, lambda part: part.segment):
        yield _joined(segment, list(group))


def _joined(segment: int, parts: Sequence[FilteredSamples]) -> FilteredSamples:
    t, values, tau = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t", "values", "tau"))
    held = [part.held for part in parts if part.held is not None]
    return FilteredSamples(t, values, tau, segment, held=np.concatenate(held) if held else None)


def remembered(samples_of: SamplesOf) -> SamplesOf:
    """The same rows, made once."""
    made: dict[str, list[FilteredSamples]] = {}

    def given(recording: Recording) -> Iterable[FilteredSamples]:
        if recording.name not in made:
            made[recording.name] = list(whole_runs(samples_of(recording)))
        return made[recording.name]

    return given
