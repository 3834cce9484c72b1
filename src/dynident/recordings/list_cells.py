"""Parquet columns that hold a list in every row, as LeRobot's data sets do: one column for each place in the list."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dynident.recordings.arrow import from_numbers, open_parquet_stream

_LONGEST = 256
_ABOUT = Path("meta") / "info.json"
_DEEPEST = 3
"""Folders above a file of a data set that its description is looked for in: data/chunk-000/file-000.parquet."""


def list_columns(path: Path, schema: pa.Schema) -> dict[str, int]:
    """Return the columns that hold lists of numbers, with the length of the first list of each."""
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
    with open_parquet_stream(path) as file:
        first = next(file.iter_batches(1, columns=names, use_threads=False), None)
    if first is None:
        return {}
    # The first list stands for all: a joint has its place in every row.
    lengths = {name: pc.list_value_length(first.column(name))[0].as_py() or 0 for name in names}
    return {name: length for name, length in lengths.items() if 0 < length <= _LONGEST}


def name_list_places(path: Path, lists: Mapping[str, int]) -> dict[str, tuple[str, ...]]:
    """Return the names of the columns that every list becomes.

    They are state1, state2, …, or state.shoulder.pos where the data set names them: a data set of LeRobot says in
    `meta/info.json` what stands in the lists of its files.

    Parameters
    ----------
    path : path
        Of the Parquet file.
    lists : mapping
        Lengths of the lists by column.

    Returns
    -------
    mapping
        Of columns to the names of their places.
    """
    names = _read_stated_names(path)
    return {name: names.get((name, length)) or make_counted_names(name, length) for name, length in lists.items()}


def expand_names(schema: pa.Schema, lists: Mapping[str, tuple[str, ...]]) -> list[str]:
    """Return the names of the columns, with those of every list in its place."""
    return [name for field in schema for name in lists.get(field.name, (field.name,))]


def find_stored_name(name: str, lists: Mapping[str, tuple[str, ...]]) -> str:
    """Return the column of the file that holds a column."""
    return next((column for column, names in lists.items() if name in names), name)


def expand_lists(batch: pa.RecordBatch, columns: list[str], lists: Mapping[str, tuple[str, ...]]) -> pa.RecordBatch:
    """Return a batch of the requested columns, those in lists among them."""
    values = []
    for name in columns:
        stored = find_stored_name(name, lists)
        column = batch.column(batch.schema.get_field_index(stored))
        if stored in lists:
            place = lists[stored].index(name)
            short = pc.less_equal(pc.list_value_length(column), place)
            # Arrow's list_element fails at lists that are too short: those give NaN, by the slow way.
            if pc.any(short).as_py():
                rows = [row[place] if row is not None and len(row) > place else np.nan for row in column.to_pylist()]
                column = from_numbers(np.array(rows, dtype=np.float64))
            else:
                column = pc.list_element(column, place)
        values.append(column)
    return pa.RecordBatch.from_arrays(values, names=columns)


def make_counted_names(name: str, length: int) -> tuple[str, ...]:
    """Return names for the places of a list: q1, q2, …."""
    joint = "_" if name[-1:].isdigit() else ""
    return tuple(f"{name}{joint}{index + 1}" for index in range(length))


def _read_stated_names(path: Path) -> dict[tuple[str, int], tuple[str, ...]]:
    """Return the names of a data set's lists, by column and length; none if the file lies in no data set."""
    # A data set lies in folders of its own: its description is looked for in the nearest ones above the file.
    about = next(
        (candidate for folder in path.absolute().parents[:_DEEPEST] if (candidate := folder / _ABOUT).is_file()), None
    )
    try:
        features = json.loads(about.read_text(encoding="utf-8"))["features"] if about is not None else {}
        named = {name: _flatten_names(feature.get("names")) for name, feature in features.items()}
    except (OSError, ValueError, KeyError, AttributeError, TypeError):
        return {}
    return {
        (name, len(places)): tuple(f"{name}.{place}" for place in places)
        for name, places in named.items()
        if places and len(set(places)) == len(places)
    }


def _flatten_names(names: Any) -> list[str]:
    """Return names as one list, of a list or of groups: {"motors": [...]}."""
    if isinstance(names, dict):
        return [place for part in names.values() for place in _flatten_names(part)]
    return [str(place) for place in names] if isinstance(names, list) else []
