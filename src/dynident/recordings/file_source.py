"""A user's file as it is, whatever its format: named columns in blocks of rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple, Protocol

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray, IntArray
from dynident.recordings.arrow import parse_numbers, to_floats
from dynident.recordings.columns import Layout
from dynident.recordings.file_limits import TITLE, check_columns
from dynident.recordings.metadata import RecordingError


class RawRows(NamedTuple):
    """Rows of the file in SI: first_row counts data rows from 0; t (m,), segment (m,), values (m, c) by kinds."""

    first_row: int
    t: FloatArray
    segment: IntArray
    values: FloatArray


class RawSource(Protocol):
    """A file, or arrays, that can be read from the beginning as often as needed."""

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Yield t and segment alone; values are empty."""
        ...

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Yield everything that the layout names."""
        ...


class FileSource:
    """A user's file with named columns.

    Parameters
    ----------
    names : sequence of str
        Of the columns.
    units : mapping, optional
        Units that the file states, by column.
    """

    sample_rows = 1 << 16
    """First rows that are enough of a sample to tell the columns, and are read in a moment."""
    texts: Mapping[str, Sequence[str]] = MappingProxyType({})
    """The first cells of columns that hold words, by their names."""
    has_gaps = False
    """Whether cells of the first rows are empty."""
    remarks: tuple[str, ...] = ()
    """What was done to read the file, where that is not plain."""

    def __init__(self, names: Sequence[str], units: Mapping[str, str] | None = None) -> None:
        check_columns(len(names))
        for name in names:
            _check_name(name)
        self.names = list(names)
        self.units = dict(units or {})

    def blocks(self) -> Iterator[FloatArray]:
        """Yield all columns as they are, (m, columns) at a time; what is no number is NaN."""
        first = 0
        for batch in self._batches(self.names):
            yield np.column_stack([to_float_column(batch, name, first) for name in self.names])
            first += batch.num_rows

    def times(self, layout: Layout) -> Iterator[RawRows]:
        """Yield t and segment alone; values are empty."""
        yield from self._read(layout, ())

    def rows(self, layout: Layout) -> Iterator[RawRows]:
        """Yield everything that the layout names."""
        yield from self._read(layout, tuple(column.source for column in layout.columns))

    def _read(self, layout: Layout, columns: tuple[str, ...]) -> Iterator[RawRows]:
        sources = [layout.t.source, *([layout.segment.source] if layout.segment else []), *columns]
        first = 0
        # A column may serve two signals, and is read once.
        for batch in self._batches(list(dict.fromkeys(sources))):
            t = layout.t.convert(to_float_column(batch, layout.t.source, first))
            segment = np.zeros(len(t), dtype=np.int64)
            if layout.segment is not None:
                segment = _to_whole_numbers(
                    to_float_column(batch, layout.segment.source, first), layout.segment.source, first
                )
            values = np.empty((len(t), len(columns)))
            for index, column in enumerate(layout.columns if columns else ()):
                values[:, index] = column.convert(to_float_column(batch, column.source, first))
            if columns and layout.mixing is not None:
                # Motors that act on several joints: their torques are turned into the joints' torques row by row.
                values[:, layout.columns_of_kind("tau")] = values[:, layout.columns_of_kind("tau")] @ layout.mixing
            yield RawRows(first, t, segment, values)
            first += len(t)

    def batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        """Yield some columns as they are stored."""
        return self._batches(columns)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        raise NotImplementedError


def _check_name(name: str) -> None:
    try:
        name.encode()
    except UnicodeEncodeError as error:
        detail = f"The name {name!a} of a column is no Unicode text; rename it."
        raise RecordingError(detail, title=TITLE) from error


def to_float_column(batch: pa.RecordBatch, name: str, first_row: int) -> FloatArray:
    """Return a column as float64.

    Parameters
    ----------
    batch : pyarrow.RecordBatch
        Rows of the file.
    name : str
        Name of the column.
    first_row : int
        Data row of the file, from 0, with which the batch begins; for the message of an error.

    Returns
    -------
    (m,)
        Nulls are NaN, instants in time are seconds.

    Raises
    ------
    RecordingError
        For a column of another kind.
    """
    column = batch.column(batch.schema.get_field_index(name))
    kind = column.type
    try:
        if pa.types.is_timestamp(kind):
            # Time stamps of any resolution, by way of nanoseconds since 1970.
            column = column.cast(pa.timestamp("ns")).cast(pa.int64())
            return to_floats(column.cast(pa.float64(), safe=False)) * 1e-9
        if pa.types.is_dictionary(kind):
            column, kind = column.dictionary_decode(), kind.value_type
        if pa.types.is_string(kind) or pa.types.is_large_string(kind):
            # Words beside the signals, or in the place of single values.
            column = parse_numbers(column)
        elif pa.types.is_boolean(kind):
            column = column.cast(pa.uint8()).cast(pa.float64())
        elif not pa.types.is_float64(kind):
            column = column.cast(pa.float64(), safe=False)
    except (pa.ArrowInvalid, pa.ArrowNotImplementedError) as error:
        raise RecordingError(
            f"Column {name} holds {kind}, not numbers (rows {first_row + 1} to {first_row + batch.num_rows}): {error}",
            pointer=name,
            title="Not a number",
        ) from error
    return to_floats(column)


def _to_whole_numbers(values: FloatArray, name: str, first_row: int) -> IntArray:
    bad = np.flatnonzero(~(np.isfinite(values) & (values == np.rint(values))))
    if len(bad):
        row = first_row + int(bad[0])
        raise RecordingError(
            f"Column {name} is {values[bad[0]]} in row {row + 1}; the segment has to be a whole number.",
            pointer=name,
            row=row + 1,
        )
    return values.astype(np.int64)
