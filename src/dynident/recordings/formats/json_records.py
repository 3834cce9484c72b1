"""Reader of JSON: an object a line, an array of objects, or an object of arrays.

Values within an object are columns by the way to them: `{"arm": {"q": [0.1, 0.2]}}` is arm.q1 and arm.q2.
"""

from __future__ import annotations

import codecs
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers
from dynident.recordings.cells_without_numbers import make_counted_names
from dynident.recordings.file_size_limits import (
    DEEPEST,
    LARGEST_MESSAGE,
    LARGEST_OBJECT,
    MOST_COLUMNS,
    TITLE,
    check_columns,
    choose_block_rows,
)
from dynident.recordings.file_source import FileSource
from dynident.recordings.formats.array_files import FEWEST_ROWS, ArrayFileSource, StoredArray
from dynident.recordings.formats.text_streams import TextContent
from dynident.recordings.recording_metadata import RecordingError
from dynident.text_encoding import escape_surrogates

START = re.compile(rb"^(?:\xef\xbb\xbf)?\s*(?:\{\s*[\"}]|\[\s*[\[{])")
"""An object with a name in it, or an array of objects or arrays."""
_NEXT = re.compile(r"[^\s,]")
_READ_BYTES = 1 << 18
_BLOCK_ROWS = 8192
_LOOKED_AT, _LOOKED_AT_VALUES = 2000, 200_000
_LONGEST_WORD = 9
"""Characters of the longest word of JSON, -Infinity, and of the end of a number that is none yet, 1e-."""
_NAMES = ("name", "joint", "joint_name", "id")
"""Keys by which objects in an array say what they are of."""

Value = float | str | None


class RecordSource(FileSource):
    """The records of a JSON file, a row each."""

    sample_rows = 16_000
    """They are taken apart one by one: of more rows a look would take seconds."""

    def __init__(self, content: TextContent) -> None:
        self._content = content
        # Columns are learned from the first records; keys that come up later are not read.
        head: list[dict[str, Value]] = []
        columns: dict[str, None] = {}
        values = 0
        for record in _read_records(content):
            head.append(_flatten_record(record))
            columns |= dict.fromkeys(head[-1])
            check_columns(len(columns))
            values += len(head[-1])
            if len(head) == _LOOKED_AT or values > _LOOKED_AT_VALUES:
                break
        if not columns:
            raise RecordingError("The file contains no JSON object with values.", title=TITLE)
        super().__init__(list(columns))
        self.texts = {
            name: tuple(cell if isinstance(cell, str) else "" for cell in (row.get(name) for row in head))
            for name in columns
            if any(isinstance(row.get(name), str) for row in head)
        }
        self.has_gaps = any(len(row) < len(columns) or None in row.values() for row in head)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        size = min(_BLOCK_ROWS, choose_block_rows(len(columns)))
        rows = (_flatten_record(record) for record in _read_records(self._content))
        while part := list(itertools.islice(rows, size)):
            arrays = [self._make_column([row.get(name) for row in part], name) for name in columns]
            yield pa.RecordBatch.from_arrays(arrays, names=columns)

    def _make_column(self, values: Sequence[Value], name: str) -> pa.Array:
        if name in self.texts:
            return pa.array([None if value is None else escape_surrogates(str(value)) for value in values], pa.string())
        return from_numbers(
            np.array([value if isinstance(value, float) else np.nan for value in values], dtype=np.float64)
        )


def open_json(content: TextContent) -> FileSource:
    """Open a file of JSON.

    Parameters
    ----------
    content : TextContent
        The text, which is read from its beginning several times.

    Returns
    -------
    FileSource
        An `ArrayFileSource` for one object with an array for every signal, else a `RecordSource`.

    Raises
    ------
    RecordingError
        For what is no JSON, or holds no records.
    """
    # Two values are enough to tell one object that holds everything from an object a row.
    records = list(itertools.islice(_read_objects(content), 2))
    if len(records) == 1 and isinstance(records[0], dict):
        arrays = list(_find_arrays(records[0], "", 0))
        if arrays:
            return ArrayFileSource(arrays)
    return RecordSource(content)


def _read_records(content: TextContent) -> Iterator[object]:
    """Yield the records one by one; those of a single object are the longest array of objects in it."""
    objects = _read_objects(content)
    first, second = next(objects, None), next(objects, None)
    if second is None and isinstance(first, dict):
        inner = [value for value in first.values() if isinstance(value, list) and value and isinstance(value[0], dict)]
        if inner:
            yield from max(inner, key=len)
            return
    yield from (record for record in (first, second) if record is not None)
    yield from objects


def _read_objects(content: TextContent) -> Iterator[object]:
    """Yield the values that stand one behind another; one that the end of the file cuts off is left out."""
    decoder = json.JSONDecoder()
    decode = codecs.getincrementaldecoder("utf-8-sig")(errors="replace").decode
    text, place, number, at_end = "", 0, 0, False
    with content.open() as file:
        while True:
            following = _NEXT.search(text, place)
            # Between values there may be white space and commas, as in an array.
            place = len(text) if following is None else following.start()
            if number == 0 and text.startswith("[", place):
                place += 1  # one array around all records
                number = 1
                continue
            try:
                # An array is closed behind its last record.
                value, end = decoder.raw_decode(text, place) if not text.startswith("]", place) else (None, place + 1)
            except (ValueError, RecursionError) as error:
                # Python's decoder cannot go on where it stopped: more text is read and the value begun again. Reading
                # at least as much as is waiting keeps the total work proportional to the size.
                n_left, row = len(text) - place, max(number, 1)
                if at_end and (not n_left or (number > 1 and _is_cut_off(error, text))):
                    return
                if at_end or not _is_cut_off(error, text):
                    raise RecordingError(
                        f"Record {row} cannot be read as JSON: {error}", title=TITLE, row=row
                    ) from error
                longest = LARGEST_OBJECT if number <= 1 else LARGEST_MESSAGE
                if n_left > longest:
                    raise RecordingError(
                        f"Record {row} is longer than {longest >> 20} MB. Write one object per line, or CSV.",
                        title=TITLE,
                        row=row,
                    ) from error
                part = file.read(max(_READ_BYTES, n_left))
                at_end = not part
                text, place = text[place:] + decode(part, final=at_end), 0
                continue
            place = end
            if isinstance(value, (dict, list)):
                number = max(number, 1) + 1
                yield value


def _is_cut_off(error: Exception, text: str) -> bool:
    """Return whether text that is no JSON may become some with the text that follows."""
    if not isinstance(error, json.JSONDecodeError):
        return False
    is_open = error.msg.startswith("Unterminated string") and "\n" not in text[error.pos :]
    return is_open or error.pos >= len(text.rstrip()) - _LONGEST_WORD


def _flatten_record(record: object) -> dict[str, Value]:
    """Return the values of a record by the path to them."""
    values: dict[str, Value] = {}
    _collect_values(record, "", values, 0)
    return values


def _collect_values(value: object, name: str, values: dict[str, Value], depth: int) -> None:
    if depth > DEEPEST:
        raise RecordingError(f"{name[:60]} is nested deeper than {DEEPEST} levels.", title=TITLE)
    if isinstance(value, dict):
        for key, inner in value.items():
            _collect_values(inner, f"{name}.{key}" if name else str(key), values, depth + 1)
    elif isinstance(value, list):
        if len(values) + len(value) > MOST_COLUMNS:
            check_columns(len(values) + len(value))
        for own, inner in zip(_name_items(name or "column", value), value, strict=True):
            _collect_values(inner, own, values, depth + 1)
    elif isinstance(value, str) or value is None:
        values[name or "column"] = value
    else:
        values[name or "column"] = _to_number(value)


def _name_items(name: str, items: Sequence[object]) -> Sequence[str]:
    """Return names for the items of an array: their own (keys such as "name"), else numbers."""
    for key in _NAMES:
        labels = [item.get(key) if isinstance(item, dict) else None for item in items]
        if labels and all(isinstance(label, str) for label in labels) and len(set(labels)) == len(labels):
            return [f"{name}.{label}" for label in labels]
    return make_counted_names(name, len(items))


def _to_number(value: Any) -> float:
    try:
        return float(value)
    except OverflowError:
        return np.nan


def _find_arrays(value: Mapping[str, Any], name: str, depth: int) -> Iterator[StoredArray]:
    """Yield the arrays of numbers in an object that holds one for every signal."""
    if depth > DEEPEST:
        raise RecordingError(f"{name[:60]} is nested deeper than {DEEPEST} levels.", title=TITLE)
    for key, inner in value.items():
        own = f"{name}.{key}" if name else str(key)
        if isinstance(inner, dict) and len(inner) >= FEWEST_ROWS and all(map(str.isdigit, inner)):
            inner = list(inner.values())  # by the number of the row, as pandas writes it
        if isinstance(inner, dict):
            yield from _find_arrays(inner, own, depth + 1)
        elif isinstance(inner, list) and _has_rows(inner):
            try:
                values = np.array(inner, dtype=np.float64)
            except (TypeError, ValueError, OverflowError):
                continue
            if 1 <= values.ndim <= 2:
                yield StoredArray(own, values.shape, _make_reader(values))


def _has_rows(values: list[Any]) -> bool:
    """Return whether an array, or the first array in it, is long enough for a signal of numbers."""
    first = values[0] if values else None
    inner = len(first) if isinstance(first, list) else 0
    return max(len(values), inner) >= FEWEST_ROWS and not isinstance(first, (dict, str))


def _make_reader(values: FloatArray) -> Any:
    def read(first: int, last: int, axis: int) -> FloatArray:
        return values[first:last] if axis == 0 else values[:, first:last].T

    return read
