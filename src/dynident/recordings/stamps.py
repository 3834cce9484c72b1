"""Time in two columns, whole seconds and the nanoseconds within them: joined to one more column."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

import pyarrow as pa

from dynident.recordings.arrow import from_numbers
from dynident.recordings.raw import FileSource, to_float_column

_NANO = re.compile(r"^(?P<whose>.*?)(?:nano[_ ]?|n)(?P<seconds>secs?|seconds)$", re.IGNORECASE)
_WORDS = ("sec", "secs", "seconds")


def find_stamp_pairs(names: Sequence[str]) -> dict[str, tuple[str, str]]:
    """Return pairs of columns by their common name: `stamp.sec` and `stamp.nanosec` are `stamp.time`."""
    pairs = {}
    for name in names:
        match = _NANO.match(name)
        if match is None:
            continue
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
