"""Columns of time that a file lacks: joined from seconds and nanoseconds, or made from a stated rate."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import numpy as np
import pyarrow as pa

from dynident.recordings.arrow import from_numbers
from dynident.recordings.file_source import FileSource, to_float_column

_TIME = "t"


class StatedRateSource(FileSource):
    """A file whose rows are evenly spaced in time: `t` in s, from 0; it replaces a column of that name."""

    def __init__(self, source: FileSource, rate: float) -> None:
        self._source, self._rate = source, rate
        names = [name for name in source.names if name != _TIME]
        super().__init__([_TIME, *names], {**source.units, _TIME: "s"})
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.remarks = source.has_gaps, source.remarks

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed = [name for name in columns if name != _TIME]
        first = 0
        # Some column has to be read even if only the time is wanted: it tells the number of rows.
        for batch in self._source.batches(needed or self._source.names[:1]):
            t = np.arange(first, first + batch.num_rows) / self._rate
            values = [from_numbers(t) if name == _TIME else batch.column(name) for name in columns]
            yield pa.RecordBatch.from_arrays(values, names=columns)
            first += batch.num_rows


def add_stated_time(source: FileSource, rate: float | None) -> FileSource:
    """Return the file with the time that a stated rate in Hz gives its rows; the same object without a rate."""
    return source if rate is None else StatedRateSource(source, rate)


_NANO = re.compile(r"^(?P<whose>.*?)(?:nano[_ ]?|n)(?P<seconds>secs?|seconds)$", re.IGNORECASE)
_WORDS = ("sec", "secs", "seconds")


def find_stamp_pairs(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return pairs of columns by their common name: `stamp.sec` and `stamp.nanosec` are `stamp.time`."""
    pairs = {}
    for name in names:
        match = _NANO.match(name)
        if match is None:
            continue
        # Nanoseconds alone are a time as well: only beside seconds of the same name are they a part of one.
        whole = next((candidate for word in _WORDS if (candidate := f"{match['whose']}{word}") in names), None)
        ours = f"{match['whose']}time"
        if whole is not None and ours not in names:
            pairs[ours] = whole, name
    return pairs


class SplitStampSource(FileSource):
    """A file with the joined time of two columns in front of the others."""

    def __init__(self, source: FileSource, pairs: dict[str, tuple[str, str]]) -> None:
        self._source, self._pairs = source, pairs
        self.sample_rows, self.texts = source.sample_rows, source.texts
        self.has_gaps, self.remarks = source.has_gaps, source.remarks
        super().__init__([*pairs, *source.names], {**source.units, **dict.fromkeys(pairs, "s")})

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed = [column for name in columns for column in self._pairs.get(name, (name,))]
        first_row = 0
        for batch in self._source.batches(list(dict.fromkeys(needed))):
            values = [
                self._join_stamps(batch, name, first_row) if name in self._pairs else batch.column(name)
                for name in columns
            ]
            yield pa.RecordBatch.from_arrays(values, names=columns)
            first_row += batch.num_rows

    def _join_stamps(self, batch: pa.RecordBatch, name: str, first_row: int) -> pa.Array:
        whole, nano = (to_float_column(batch, column, first_row) for column in self._pairs[name])
        return from_numbers(whole + 1e-9 * nano)


def join_split_stamps(source: FileSource) -> FileSource:
    """Return the file with its time joined, if it stands in two columns; else the same object."""
    pairs = find_stamp_pairs(source.names)
    return SplitStampSource(source, pairs) if pairs else source
