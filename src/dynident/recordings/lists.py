"""Parquet columns that hold a list in every row, as LeRobot's data sets do: a column for each place in the list."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dynident.recordings.arrow import from_numbers, streamed_parquet

_LONGEST = 256


def list_columns(path: Path, schema: pa.Schema) -> dict[str, int]:
    """Give the columns that hold lists of numbers, and how long the first list of each is."""
    names = [
        field.name
        for field in schema
        if (
            pa.types.is_list(field.type)
            or pa.types.is_fixed_size_list(field.type)
            or pa.types.is_large_list(field.type)
        )
        and (pa.types.is_floating(field.type.value_type) or pa.types.is_integer(field.type.value_type))
    ]
    if not names:
        return {}
    with streamed_parquet(path) as file:
        first = next(file.iter_batches(1, columns=names, use_threads=False), None)
    if first is None:
        return {}
    lengths = {name: len(first.column(name)[0].as_py() or ()) for name in names}
    return {name: length for name, length in lengths.items() if 0 < length <= _LONGEST}


def spread_names(schema: pa.Schema, lists: Mapping[str, int]) -> list[str]:
    """Names of the columns, with those of every list in its place: state becomes state1, state2, …."""
    return [name for field in schema for name in _names(field.name, lists)]


def stored_name(name: str, lists: Mapping[str, int]) -> str:
    """The column of the file that a column is in."""
    return next((one for one in lists if name in _names(one, lists)), name)


def spread(batch: pa.RecordBatch, columns: list[str], lists: Mapping[str, int]) -> pa.RecordBatch:
    """Give the columns that are asked for, those in lists among them."""
    values = []
    for name in columns:
        stored = stored_name(name, lists)
        column = batch.column(batch.schema.get_field_index(stored))
        if stored in lists:
            place = _names(stored, lists).index(name)
            short = pc.less_equal(pc.list_value_length(column), place)
            if pc.any(short).as_py():
                rows = [row[place] if row is not None and len(row) > place else np.nan for row in column.to_pylist()]
                column = from_numbers(np.array(rows, dtype=np.float64))
            else:
                column = pc.list_element(column, place)
        values.append(column)
    return pa.RecordBatch.from_arrays(values, names=columns)


def _names(name: str, lists: Mapping[str, int]) -> list[str]:
    if name not in lists:
        return [name]
    joint = "_" if name[-1:].isdigit() else ""
    return [f"{name}{joint}{index + 1}" for index in range(lists[name])]
