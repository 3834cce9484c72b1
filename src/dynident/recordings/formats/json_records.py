"""Reader of JSON: an object a line, an array of objects, or an object of arrays.

Values within an object are columns by the way to them: `{"arm": {"q": [0.1, 0.2]}}` is arm.q1 and arm.q2.
"""

from __future__ import annotations

import codecs
import itertools
import json
import re
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from typing import IO, Any

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
_BLOCK_ROWS, _FIRST_ROWS = 8192, 512
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
        shape: _Shape | None = None
        for record in _read_records(content):
            shape = shape if head else _find_shape(record)
            head.append(_flatten_record(record))
            columns |= dict.fromkeys(head[-1])
            check_columns(len(columns))
            values += len(head[-1])
            if len(head) == _LOOKED_AT or values > _LOOKED_AT_VALUES:
                break
        if not columns:
            raise RecordingError("The file contains no JSON object with values.", title=TITLE)
        super().__init__(list(columns))
        self._parsed: IO[bytes] | None = None
        # Of two values with one name, {"q1": 1, "q": [1, 2]}, the later one counts: the shape alone would have both.
        self._shape = shape if list(head[0]) == self.names and _count_values(shape) == len(columns) else None
        self.texts = {
            name: tuple(cell if isinstance(cell, str) else "" for cell in (row.get(name) for row in head))
            for name in columns
            if any(isinstance(row.get(name), str) for row in head)
        }
        self.has_gaps = any(len(row) < len(columns) or None in row.values() for row in head)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        if self._parsed is None:
            yield from (batch.select(columns) for batch in self._parse())
            return
        fields = [self.names.index(name) for name in columns]
        options = pa.ipc.IpcReadOptions(included_fields=fields)
        self._parsed.seek(0)
        with pa.ipc.open_stream(self._parsed, options=options) as stream:
            yield from (batch.select(columns) for batch in stream)

    def _parse(self) -> Iterator[pa.RecordBatch]:
        """Yield all columns, and keep them in a temporary file: taking text apart is slow, and files are read often."""
        size = min(_BLOCK_ROWS, choose_block_rows(len(self.names)))
        schema = pa.schema([(name, pa.string() if name in self.texts else pa.float64()) for name in self.names])
        records = _read_records(self._content)
        # It is deleted with this object, or where nobody reads on to the end.
        file = tempfile.TemporaryFile()  # noqa: SIM115
        with pa.ipc.new_stream(file, schema) as sink:
            # Whoever looks at the first block alone has not to wait for more.
            n_next = min(size, _FIRST_ROWS)
            while part := list(itertools.islice(records, n_next)):
                n_next = size
                batch = pa.RecordBatch.from_arrays(self._make_columns(part), schema=schema)
                sink.write_batch(batch)
                yield batch
        self._parsed = file

    def _make_columns(self, records: Sequence[object]) -> list[pa.Array]:
        """Return the columns of some records: quickly where all have the same keys and lists of the same lengths."""
        rows: list[list[Any]] = []
        if self._shape is not None:
            for record in records:
                row: list[Any] = []
                if not _append_values(record, self._shape, row):
                    break
                rows.append(row)
        if len(rows) < len(records):
            flat = [_flatten_record(record) for record in records]
            return [self._make_column([row.get(name) for row in flat], name) for name in self.names]
        return [
            self._make_column(values, name) for name, values in zip(self.names, zip(*rows, strict=True), strict=True)
        ]

    def _make_column(self, values: Sequence[Any], name: str) -> pa.Array:
        if name in self.texts:
            return pa.array([None if value is None else escape_surrogates(str(value)) for value in values], pa.string())
        kinds = set(map(type, values))
        if not kinds <= {float, int}:
            values = [_to_number(value) if isinstance(value, (int, float)) else np.nan for value in values]
        try:
            return from_numbers(np.array(values, dtype=np.float64))
        except OverflowError:
            return from_numbers(np.array([_to_number(value) for value in values]))


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
    # One object may hold everything, or one for each run or joint; else each is a row.
    records: list[object] = []
    length = 0
    for record, size in _read_objects(content):
        records.append(record)
        length += size
        # Runs in a list may be as long together as one object that holds them.
        if len(records) > 1 and (length > LARGEST_OBJECT or len(records) > _MOST_HOLDERS):
            break
    else:
        is_list = content.read_start(_LOOKED_AT_BYTES).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"[")
        are_objects = all(isinstance(record, dict) for record in records)
        whole = records[0] if len(records) == 1 else {"run": records} if is_list and are_objects else None
        arrays = list(_find_arrays(whole, "", 0)) if isinstance(whole, dict) else []
        holder = _find_table_holder(whole) if arrays else None
        # A small table beside arrays that are none of it says something about them.
        if len(arrays) > len(list(_find_arrays(holder, "", 0)) if holder else []):
            return ArrayFileSource(arrays)
    return RecordSource(content)


def _read_records(content: TextContent) -> Iterator[object]:
    """Yield the records one by one; those of a single object are the longest array of objects in it."""
    objects = (value for value, _ in _read_objects(content))
    first, second = next(objects, None), next(objects, None)
    if second is None and isinstance(first, dict):
        if _has_times(first):
            yield from ({"time": float(key), **value} for key, value in first.items())
            return
        inner = [value for value in first.values() if isinstance(value, list) and value and isinstance(value[0], dict)]
        longest = max(inner, key=len, default=[])
        holder = _find_table_holder(first) if _find_rows(first) or len(longest) < FEWEST_ROWS else None
        if holder or longest:
            yield from _name_cells(holder["columns"], _find_rows(holder)) if holder else longest
            return
    yield from (record for record in (first, second) if record is not None)
    yield from objects


def _has_times(record: dict[str, Any]) -> bool:
    """Return whether the keys of an object are the times of the objects in it."""
    if len(record) < FEWEST_ROWS or not all(isinstance(value, dict) for value in record.values()):
        return False
    try:
        times = np.array([float(key) for key in record])
    except ValueError:
        return False
    return bool(np.isfinite(times).all() and (np.diff(times) > 0.0).all())


def _find_table_holder(value: object, depth: int = 0) -> dict[str, Any] | None:
    """Return the object, or one inside it, that holds the rows of a table and the names of its columns."""
    if isinstance(value, list) and len(value) == 1 and depth <= DEEPEST:
        return _find_table_holder(value[0], depth + 1)
    if not isinstance(value, dict) or depth > DEEPEST:
        return None
    holders = (_find_table_holder(inner, depth + 1) for inner in value.values())
    return value if _find_rows(value) else next(filter(None, holders), None)


def _find_rows(value: dict[str, Any]) -> list[Any]:
    """Return the rows of the table that an object is, as data bases answer; none where it holds other lists as long."""
    columns = value.get("columns")
    if not isinstance(columns, list) or not all(isinstance(name, str) for name in columns):
        return []
    lists = [inner for key, inner in value.items() if isinstance(inner, list) and key not in ("columns", "index")]
    counts = [sum(isinstance(row, list) and len(row) == len(columns) for row in rows) for rows in lists]
    tables = [rows for rows, n in zip(lists, counts, strict=True) if len(rows) >= FEWEST_ROWS and 2 * n > len(rows)]
    is_alone = len(tables) == 1 and sum(len(other) == len(tables[0]) for other in lists) == 1
    return tables[0] if is_alone else []


def _name_cells(columns: list[str], rows: list[Any]) -> Iterator[dict[str, Any]]:
    for number, row in enumerate(rows, 1):
        if (n_cells := len(row) if isinstance(row, list) else 0) != len(columns):
            reason = f"Row {number} of the table has {n_cells} values, but {len(columns)} columns have names."
            raise RecordingError(reason, title=TITLE, row=number)
        yield dict(zip(columns, row, strict=True))


def _read_objects(content: TextContent) -> Iterator[tuple[object, int]]:
    """Yield the values that stand one behind another, with their lengths; one that the end cuts off is left out."""
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
            size, place = end - place, end
            if isinstance(value, (dict, list)):
                number = max(number, 1) + 1
                yield value, size


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
        labels = _find_labels(value)
        for key, inner in value.items():
            if labels and isinstance(inner, list) and len(inner) == len(labels) and _is_labelled(str(key), inner):
                # A list beside the names of its items: {"interface_names": ["position"], "values": [0.1]}.
                stem = name if str(key) in _VALUES else f"{name}.{key}" if name else str(key)
                for label, item in zip(labels, inner, strict=True):
                    _collect_values(item, f"{stem}.{label}" if stem else label, values, depth + 1)
                continue
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


_VALUES = ("value", "values")


def _find_labels(value: dict[Any, Any]) -> list[str]:
    """Return the names that an object has in a list of their own; none where it has several such lists."""
    lists = [
        inner
        for key, inner in value.items()
        if str(key).endswith("names") and isinstance(inner, list) and all(isinstance(item, str) for item in inner)
    ]
    return lists[0] if len(lists) == 1 and len(set(lists[0])) == len(lists[0]) else []


def _is_labelled(key: str, items: list[object]) -> bool:
    """Return whether names in a list of their own are those of these items: objects, or what is called values."""
    return all(isinstance(item, dict) for item in items) or (
        key in _VALUES and not any(isinstance(item, (dict, list)) for item in items)
    )


_Shape = tuple[Any, tuple["_Shape | None", ...]]
"""Keys of an object, or the length of a list, and the shapes of what is in it; None for a number or a text."""


def _find_shape(value: object, depth: int = 0) -> _Shape | None:
    """Return the shape of a value whose columns are named by its keys and places alone; None of others."""
    if isinstance(value, dict) and depth <= DEEPEST and not _find_labels(value):
        return tuple(value), tuple(_find_shape(inner, depth + 1) for inner in value.values())
    if isinstance(value, list) and depth <= DEEPEST:
        # Objects that say what they are of have other names in other records.
        is_labelled = any(isinstance(item, dict) and set(_NAMES) & set(item) for item in value)
        return None if is_labelled else (len(value), tuple(_find_shape(inner, depth + 1) for inner in value))
    return None


def _count_values(shape: _Shape | None) -> int:
    return 1 if shape is None else sum(_count_values(inner) for inner in shape[1])


def _append_values(value: Any, shape: _Shape | None, row: list[Any]) -> bool:
    """Append the numbers and texts in a value that has this shape; return False for one of another shape."""
    if shape is None:
        row.append(value)
        return not isinstance(value, (dict, list))
    keys, inner = shape
    if isinstance(value, list):
        if len(value) != keys:
            return False
        items: Sequence[Any] = value
    elif isinstance(value, dict) and tuple(value) == keys:
        items = tuple(value.values())
    else:
        return False
    return all(_append_values(item, part, row) for item, part in zip(items, inner, strict=True))


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
        if isinstance(inner, dict) and len(inner) >= FEWEST_ROWS and all(map(str.isdecimal, inner)):
            inner = list(inner.values())  # by the number of the row, as pandas writes it
        if isinstance(inner, dict):
            yield from _find_arrays(inner, own, depth + 1)
        elif isinstance(inner, list) and _are_holders(inner):
            named = zip(_name_items(own, inner), inner, strict=True)
            yield from _find_arrays(dict(named), "", depth + 1)
        elif isinstance(inner, list) and _has_rows(inner):
            try:
                values = np.array(inner, dtype=np.float64)
            except (TypeError, ValueError, OverflowError):
                continue
            if 1 <= values.ndim <= 2:
                yield StoredArray(own, values.shape, _make_reader(values))


_MOST_HOLDERS, _LOOKED_AT_BYTES = 64, 256
"""Objects in a list that may each hold the signals of a joint, or of a run."""


def _are_holders(values: list[Any]) -> bool:
    """Return whether the objects in a list hold arrays that are longer than the list: they are no rows."""
    if not 0 < len(values) <= _MOST_HOLDERS or not all(isinstance(item, dict) for item in values):
        return False
    longest = [max((len(inner) for inner in item.values() if isinstance(inner, list)), default=0) for item in values]
    return min(longest) > max(2 * len(values), FEWEST_ROWS)


def _has_rows(values: list[Any]) -> bool:
    """Return whether an array, or the first array in it, is long enough for a signal of numbers."""
    first = values[0] if values else None
    inner = len(first) if isinstance(first, list) else 0
    return max(len(values), inner) >= FEWEST_ROWS and not isinstance(first, (dict, str))


def _make_reader(values: FloatArray) -> Any:
    def read(first: int, last: int, axis: int) -> FloatArray:
        return values[first:last] if axis == 0 else values[:, first:last].T

    return read


class JsonCellsSource(FileSource):
    """A table with the values of objects that stand as text in its cells, as data bases export messages.

    Parameters
    ----------
    source : FileSource
        The table.
    values : mapping of str to sequence of str
        What the objects of a column hold, by the column's name.
    """

    def __init__(self, source: FileSource, values: Mapping[str, Sequence[str]]) -> None:
        self._source = source
        self._places = {
            (name if len(values) == 1 and name not in source.names else f"{column}.{name}"): (column, name)
            for column, names in values.items()
            for name in names
        }
        super().__init__([*(name for name in source.names if name not in values), *self._places], source.units)
        self.sample_rows, self.inner, self.clocks = RecordSource.sample_rows, source, source.clocks
        self.texts = {name: cells for name, cells in source.texts.items() if name not in values}
        self.has_gaps = source.has_gaps

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed = [self._places[name][0] if name in self._places else name for name in columns]
        for batch in self._source.batches(list(dict.fromkeys(needed))):
            records = {
                column: [_parse_cell(cell) for cell in batch.column(column).to_pylist()]
                for column in {self._places[name][0] for name in columns if name in self._places}
            }
            arrays = []
            for name, stored in zip(columns, needed, strict=True):
                if name not in self._places:
                    arrays.append(batch.column(stored))
                    continue
                values = [record.get(self._places[name][1]) for record in records[stored]]
                arrays.append(from_numbers(np.array([v if isinstance(v, float) else np.nan for v in values])))
            yield pa.RecordBatch.from_arrays(arrays, names=columns)


def expand_json_cells(source: FileSource) -> FileSource:
    """Return the table with the values of objects in its cells as columns; the same object if no cells hold such."""
    values: dict[str, list[str]] = {}
    for column, cells in source.texts.items():
        filled = [cell for cell in cells if cell.strip()]
        if not filled or not all(cell.strip().startswith("{") for cell in filled):
            continue
        records = [_parse_cell(cell) for cell in filled]
        names = [name for record in records for name, value in record.items() if isinstance(value, float)]
        if names:
            values[column] = list(dict.fromkeys(names))
    return JsonCellsSource(source, values) if values else source


def _parse_cell(cell: str | None) -> dict[str, Value]:
    """Return the values of an object in a cell; none of what is no object."""
    try:
        return _flatten_record(json.loads(cell or ""))
    except (ValueError, RecursionError):
        return {}
