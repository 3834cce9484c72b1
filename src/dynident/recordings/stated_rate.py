"""The time of a file that has none, from a stated rate of its rows."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pyarrow as pa

from dynident.recordings.arrow import from_numbers
from dynident.recordings.raw import FileSource

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
