"""Read cells that are no numbers: lists in a cell, times as text, names of joints; expand them to columns."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from dynident.array_types import IntArray
from dynident.recordings.arrow_tables import from_numbers, is_list, parse_numbers, pc
from dynident.recordings.file_source import FileSource, to_float_column
from dynident.recordings.time_columns import ClockOfDay, is_time_name
from dynident.recordings.units import are_times, are_times_of_day, parse_seconds

_LONGEST, _ABOUT = 256, Path("meta") / "info.json"
_DATA, _DEEPEST = "data", 3
"""Folder of a data set that its files lie in, and folders above a file that it is looked for in:
data/chunk-000/file-000.parquet."""


def list_columns(first: pa.RecordBatch) -> dict[str, int]:
    """Return the columns that hold lists of numbers or of words, with the length of the first list of each."""
    lengths = {}
    for field, column in zip(first.schema, first.columns, strict=True):
        if not is_list(field.type) or not _is_plain(field.type.value_type) or not len(column):
            continue
        # The first list stands for all: a joint has its place in every row.
        length = pc.list_value_length(column)[0].as_py() or 0
        if 0 < length <= _LONGEST:
            lengths[field.name] = length
    return lengths


def _is_plain(kind: pa.DataType) -> bool:
    return bool(pa.types.is_floating(kind) or pa.types.is_integer(kind) or pa.types.is_string(kind))


def list_texts(first: pa.RecordBatch) -> dict[str, tuple[str, ...]]:
    """Return the first cells of columns that hold words, by their names."""
    texts = {}
    for field, column in zip(first.schema, first.columns, strict=True):
        if not (pa.types.is_string(field.type) or pa.types.is_large_string(field.type)):
            continue
        if 2 * parse_numbers(column.cast(pa.string())).null_count > len(column):
            texts[field.name] = tuple(cell or "" for cell in column.to_pylist())
    return texts


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
    return [
        name
        for field in schema
        for name in lists.get(field.name, () if pa.types.is_nested(field.type) else (field.name,))
    ]


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
                rows = [row[place] if row is not None and len(row) > place else None for row in column.to_pylist()]
                column = pa.array(rows, column.type.value_type)
            else:
                column = pc.list_element(column, place)
        values.append(column)
    return pa.RecordBatch.from_arrays(values, names=columns)


def make_counted_names(name: str, length: int) -> tuple[str, ...]:
    """Return names for the places of a list: q1, q2, …."""
    joint = "_" if name[-1:].isdecimal() else ""
    return tuple(f"{name}{joint}{index + 1}" for index in range(length))


def _read_stated_names(path: Path) -> dict[tuple[str, int], tuple[str, ...]]:
    """Return the names of a data set's lists, by column and length; none if the file lies in no data set."""
    # Of another data set above or beside the file nothing is told: its description stands beside the folder of data.
    roots = (folder.parent for folder in path.absolute().parents[:_DEEPEST] if folder.name == _DATA)
    about = next((candidate for root in roots if (candidate := root / _ABOUT).is_file()), None)
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


_COUNTED = re.compile(r"^(?P<stem>.*?)[_.\[/ ]*(?P<number>\d+)\]?$")
_INDEX_WITHIN = re.compile(r"^(?P<stem>[^\[]+)\[(?P<number>\d+)\](?P<behind>[^\[]+\[\d+\])$")
_OF_NAMES = re.compile(r"^(?P<prefix>(?:.*?[^A-Za-z])??)(?:joint[_ ]?names?|names?|joints?|motors?)$", re.IGNORECASE)
_OF_IDS = re.compile(
    r"(?:^|[^a-z])(?:id|(?:motor|joint|axis|servo|can|node)[_ ]?(?:id|index|number|nr)?)$", re.IGNORECASE
)
"""Whole numbers of motors or joints, one a row."""
_OF_SIGNALS = re.compile(
    r"(?:^|[^a-z])(?:tag|signal|channel|variable|series|metric|field|topic|key|item|path|quantity|measure|measurement|"
    r"kind|type|parameter)(?:[_ ]?name)?$",
    re.IGNORECASE,
)
"""Names of signals, one a row, as exports of historians and plots have them."""
_OF_PARTS = re.compile(r"(?:^|[^a-z])(?:nsecs?|nanosecs?|msecs?|milli(?:tm|s|sec\w*))$", re.IGNORECASE)
"""Parts of a time."""
_OF_ROWS = re.compile(rf"{_OF_PARTS.pattern}|(?:^|[^a-z])(?:seq|index)$|^$", re.IGNORECASE)
"""Columns of a row, and not of the joint that the row is of."""
_MOST_JOINTS = 256
_ROWS = 1000


@dataclass(frozen=True)
class _NamedTable:
    """Columns with names of joints, and the columns of each of their signals in the same order.

    Each of `names` is a column, or several whose words together are one name, such as that of the quantity and that of
    the joint. `joints` are all names of the first rows. `signals` has the file's columns by what those of all joints
    are called.
    """

    names: tuple[tuple[str, ...], ...]
    joints: tuple[str, ...]
    signals: Mapping[str, tuple[str, ...]]

    def list_columns(self) -> dict[str, tuple[str, str]]:
        """Return the signal and the joint of every column that these tables become."""
        return {f"{signal}_{joint}": (signal, joint) for signal in self.signals for joint in self.joints}


_QUANTITY = (
    r"^\s{0,9}(?P<value>[+-]?(?:\d+(?:[.,]\d*)?|[.,]\d+)(?:[eE][+-]?\d+)?)\s{0,9}"
    r"(?P<unit>[A-Za-z°µμ%‰][A-Za-z°µμ%‰/*·^.²0-9]{0,9}(?: [A-Za-z]{1,4})?)\s{0,9}$"
)
"""12.5 Nm, as some loggers write a number with its unit."""
_HEXADECIMAL = re.compile(r"^0[xX][0-9A-Fa-f]{1,8}$")


def find_quantities(texts: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """Return the unit of columns whose cells are all numbers with that unit behind them."""
    units = {}
    for name, cells in texts.items():
        parts = [re.match(_QUANTITY, cell) for cell in cells if cell]
        cell_units = {part["unit"] for part in parts if part is not None}
        if parts and None not in parts and len(cell_units) == 1:
            units[name] = cell_units.pop()
    return units


def find_hexadecimals(texts: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the columns whose cells are all whole numbers with the base 16, such as 0x1F."""
    return [name for name, cells in texts.items() if any(cells) and all(map(_HEXADECIMAL.match, filter(None, cells)))]


def _parse_quantities(column: pa.Array) -> pa.Array:
    value = pc.struct_field(pc.extract_regex(column, _QUANTITY), "value")
    return parse_numbers(pc.replace_substring(value, ",", "."))


def _parse_hexadecimals(column: pa.Array) -> pa.Array:
    # Few bits give few different texts; each is read once.
    coded = pc.dictionary_encode(column)
    numbers = [
        float(int(text, 16)) if text is not None and _HEXADECIMAL.match(text) else None
        for text in coded.dictionary.to_pylist()
    ]
    return pa.array(numbers, pa.float64()).take(coded.indices)


_Orders = dict[tuple[tuple[str, ...], ...], tuple[IntArray, list[tuple[str, ...]]]]
"""The order of the names of every table in a batch of rows, as `_find_orders` returns it."""


class WordCellsSource(FileSource):
    """A file with written times in seconds, numbers with their units, and signals named by the joints in its cells."""

    def __init__(
        self,
        source: FileSource,
        times: Sequence[str],
        named: Sequence[_NamedTable],
        quantities: Mapping[str, str],
        hexadecimals: Sequence[str],
    ) -> None:
        self._source = source
        self._of_day = [name for name in times if are_times_of_day(source.texts[name])]
        self._parsers = {
            **dict.fromkeys(times, parse_seconds),
            **dict.fromkeys(quantities, _parse_quantities),
            **dict.fromkeys(hexadecimals, _parse_hexadecimals),
        }
        self._places = {column: (table, *place) for table in named for column, place in table.list_columns().items()}
        used_columns = {
            column for table in named for columns in (*table.names, *table.signals.values()) for column in columns
        }
        names = [name for name in source.names if name not in used_columns]
        units = {name: unit for name, unit in source.units.items() if name not in used_columns}
        units |= {
            name: source.units[columns[0]]
            for name, (table, signal, _) in self._places.items()
            if (columns := table.signals[signal])[0] in source.units
        }
        super().__init__([*names, *self._places], {**units, **quantities, **dict.fromkeys(times, "s")})
        self.sample_rows, self.inner, self.clocks = source.sample_rows, source, source.clocks
        still_words = frozenset(names) - self._parsers.keys()
        self.texts = {name: cells for name, cells in source.texts.items() if name in still_words}
        # Where rows are of one joint each, those of the others are empty in them.
        self.has_gaps = source.has_gaps or any(len(table.joints) > len(table.names) for table in named)

    def _batches(self, columns: list[str]) -> Iterator[pa.RecordBatch]:
        needed: dict[str, None] = {}
        for name in columns:
            if name in self._places:
                table, signal, _ = self._places[name]
                needed |= dict.fromkeys((*chain(*table.names), *table.signals[signal]))
            else:
                needed[name] = None
        first_row = 0
        # Each pass over the file counts its midnights anew.
        parsers = self._parsers | {name: ClockOfDay().parse for name in self._of_day}
        for batch in self._source.batches(list(needed)):
            orders: _Orders = {}
            values = [self._column(batch, name, parsers, orders, first_row) for name in columns]
            yield pa.RecordBatch.from_arrays(values, names=columns)
            first_row += batch.num_rows

    def _column(
        self,
        batch: pa.RecordBatch,
        name: str,
        parsers: Mapping[str, Callable[[pa.Array], pa.Array]],
        orders: _Orders,
        first_row: int,
    ) -> pa.Array:
        if name not in self._places:
            column = batch.column(name)
            return parsers[name](column) if name in parsers else column
        table, signal, joint = self._places[name]
        # All signals of a table share the order of its names, which is found once for each batch.
        if table.names not in orders:
            orders[table.names] = _find_orders(batch, table.names)
        which, combinations = orders[table.names]
        sources = table.signals[signal]
        # As a rule the joints stand in the same order in all rows: the column is then passed on as it is.
        if len(combinations) == 1:
            places = [place for place, word in enumerate(combinations[0]) if word == joint]
            return batch.column(sources[places[0]]) if places else pa.nulls(batch.num_rows, pa.float64())
        values = np.full(batch.num_rows, np.nan)
        for number, words in enumerate(combinations):
            if joint in words:
                rows = which == number
                values[rows] = to_float_column(batch, sources[words.index(joint)], first_row)[rows]
        return from_numbers(values)


def _find_orders(batch: pa.RecordBatch, names: Sequence[tuple[str, ...]]) -> tuple[IntArray, list[tuple[str, ...]]]:
    """Return the number (m,) of every row's combination of names, and the combinations."""
    # Names are compared by their numbers in a dictionary: texts are few, rows are many.
    coded = [pc.dictionary_encode(join_labels([batch.column(name) for name in columns])) for columns in names]
    codes = np.column_stack([encoded.indices.to_numpy(zero_copy_only=False) for encoded in coded])
    unique, which = np.unique(codes, axis=0, return_inverse=True)
    words = [encoded.dictionary.to_pylist() for encoded in coded]
    combinations = [tuple(words[k][code].strip() for k, code in enumerate(row)) for row in unique.tolist()]
    return which.reshape(-1), combinations


def join_labels(columns: Sequence[pa.Array]) -> pa.Array:
    """Return the words of several columns as one text a row."""
    texts = [_to_text(column) for column in columns]
    return texts[0] if len(texts) == 1 else pc.binary_join_element_wise(*texts, "_")


def _to_text(column: pa.Array) -> pa.Array:
    """Return names as they stand there, whole numbers without a decimal point."""
    if pa.types.is_floating(column.type):
        column = column.cast(pa.int64(), safe=False)
    return column.cast(pa.string()).fill_null("")


def read_word_cells(source: FileSource) -> FileSource:
    """Return the file with its written times as seconds, and its signals named by the joints in its cells.

    Parameters
    ----------
    source : FileSource
        The file as it is.

    Returns
    -------
    FileSource
        The same object if no cells hold such words.
    """
    times = [name for name, cells in source.texts.items() if are_times(cells)]
    named = _find_named_tables(
        source, {name: cells for name, cells in source.texts.items() if name not in times} | _find_joint_ids(source)
    )
    words = {name: cells for name, cells in source.texts.items() if name not in times}
    quantities, hexadecimals = find_quantities(words), find_hexadecimals(words)
    if not (times or named or quantities or hexadecimals):
        return source
    return WordCellsSource(source, times, named, quantities, hexadecimals)


def _find_named_tables(source: FileSource, texts: Mapping[str, Sequence[str]]) -> list[_NamedTable]:
    tables: list[_NamedTable] = []
    numbers = _group_by_stem([name for name in source.names if name not in source.texts])
    # Columns of names, one for each place in a list of joints, and as many columns of numbers for every signal.
    for stem, columns in _group_by_stem(texts).items():
        kind = _OF_NAMES.match(stem)
        rows = set(zip(*(texts[column] for column in columns.values()), strict=True))
        # A name that stands twice in one row, or is empty before others, does not tell whose numbers are whose. At the
        # end of a row they are empty where another sender has fewer joints, such as a gripper.
        lists = ["\0".join(row).rstrip("\0").split("\0") for row in rows]
        if kind is None or any("" in words or len(set(words)) < len(words) for words in lists):
            continue
        signals: dict[str, tuple[str, ...]] = {}
        taken: set[str] = set()
        for other, places in numbers.items():
            # Of two numbers that may count the joints the first one does.
            fits = other.startswith(kind["prefix"]) and places.keys() == columns.keys()
            if fits and taken.isdisjoint(places.values()):
                signals[other] = tuple(places.values())
                taken.update(places.values())
        joints = tuple(dict.fromkeys(word for row in sorted(rows) for word in row if word))
        if signals and len(joints) <= _MOST_JOINTS:
            tables.append(_NamedTable(tuple((column,) for column in columns.values()), joints, signals))
    return tables or _find_joint_rows(source, texts)


def _find_joint_rows(source: FileSource, texts: Mapping[str, Sequence[str]]) -> list[_NamedTable]:
    """Return tables with a row for every joint and instant, with the joint's name in a column."""
    labels, others, is_of_joints = find_label_columns(source, texts)
    if not labels:
        return []
    words = list(
        dict.fromkeys("_".join(row) for row in zip(*(texts[name] for name in labels), strict=True) if all(row))
    )
    n_rows = len(texts[labels[0]])
    # A row for each value has its number in one column; of several nobody knows which it is.
    if not 1 < len(words) <= min(_MOST_JOINTS, n_rows // 2) or not (is_of_joints or len(others) == 1):
        return []
    return [_NamedTable((labels,), tuple(words), {other: (other,) for other in others})] if others else []


def find_label_columns(
    source: FileSource, texts: Mapping[str, Sequence[str]]
) -> tuple[tuple[str, ...], list[str], bool]:
    """Return the columns that say what each row is of, those of its numbers, and whether a joint is named.

    Parameters
    ----------
    source : FileSource
        The table.
    texts : mapping of str to sequence of str
        First cells of columns of words, or of numbers of joints.
    """
    joints = [name for name in texts if _OF_NAMES.match(name) or _OF_IDS.search(name)][:1]
    signals = [name for name in texts if _OF_SIGNALS.search(name) and name not in joints][:1]
    labels = tuple(name for name in texts if name in (*joints, *signals))
    if not labels:
        return (), [], False
    others = [
        name
        for name in source.names
        if name not in (*labels, *source.texts) and not is_time_name(name) and not _OF_ROWS.search(name)
    ]
    running = _find_running_columns(source, others)
    others = [name for name in others if name not in running]
    if len(others) == 1 and not joints:
        labels = _add_further_labels(source, labels, texts)
    return labels, others, bool(joints)


_AT_ONCE = 0.5
"""Share of its instants at which a name stands more than once; of rows written twice now and then it is less."""


def _add_further_labels(
    source: FileSource, labels: tuple[str, ...], texts: Mapping[str, Sequence[str]]
) -> tuple[str, ...]:
    """Return the labels, and further columns that tell signals of the same name apart, such as that of the message.

    They do where one name stands more than once at one time. A state or a mode changes from one time to another.
    """
    instants = _list_instants(source)
    for name in texts:
        if name in labels:
            continue
        rows = set(zip(instants, zip(*(texts[label] for label in labels), strict=True), texts[name], strict=False))
        finer = {(row, word) for _, row, word in rows if all(row) and word}
        n_words = Counter(row for _, row, word in rows if word)
        n_instants = Counter(row for _, row in {(t, row) for t, row, word in rows if word})
        is_told_apart = any(count > (1.0 + _AT_ONCE) * n_instants[row] for row, count in n_words.items())
        if is_told_apart and len(finer) <= min(_MOST_JOINTS, len(texts[name]) // 2):
            labels = tuple(other for other in texts if other in (*labels, name))
    return labels


def _list_instants(source: FileSource) -> list[tuple[str | float, ...]]:
    """Return what the first rows have in their columns of time; nothing where there is none."""
    names = [name for name in source.names if is_time_name(name) or _OF_PARTS.search(name)]
    batch = next(iter(source.batches(names)), None) if names else None
    if batch is None:
        return []
    columns = (
        source.texts[name] if name in source.texts else to_float_column(batch, name, 0).tolist() for name in names
    )
    return list(zip(*columns, strict=False))


def _find_running_columns(source: FileSource, names: Sequence[str]) -> set[str]:
    """Return the columns that are empty, or never go back from row to row, as clocks do and signals do not."""
    batch = next(iter(source.batches(list(names))), None) if names else None
    running = set()
    for name in names if batch is not None else ():
        values = to_float_column(batch, name, 0)[:_ROWS]
        is_empty = not np.isfinite(values).any()
        if is_empty or (np.isfinite(values).all() and (np.diff(values) >= 0.0).all() and np.ptp(values) > 0.0):
            running.add(name)
    return running


def _find_joint_ids(source: FileSource) -> dict[str, tuple[str, ...]]:
    """Return the first cells of a column with the number of the joint that each row is of, if there is one."""
    called = next((name for name in source.names if name not in source.texts and _OF_IDS.search(name)), None)
    batch = None if called is None else next(iter(source.batches([called])), None)
    if called is None or batch is None:
        return {}
    values = to_float_column(batch, called, 0)[:_ROWS]
    # Rows of one motor stand between those of others, not in one interval.
    if not np.isfinite(values).all() or (values != np.rint(values)).any() or np.mean(np.diff(values) != 0) < 0.5:
        return {}
    return {called: tuple(str(int(value)) for value in values)}


def _group_by_stem(names: Sequence[str] | Mapping[str, object]) -> dict[str, dict[int, str]]:
    """Return columns whose names differ by a number at the end, or an index within (joint[2]/value[0]): by the rest."""
    families: dict[str, dict[int, str]] = {}
    for name in names:
        inner, last = _INDEX_WITHIN.match(name), _COUNTED.match(name)
        for match, behind in ((inner, inner["behind"] if inner else ""), (last, "")):
            if match is not None and match["stem"]:
                families.setdefault(match["stem"] + behind, {})[int(match["number"])] = name
    return {
        stem: dict(sorted(places.items()))
        for stem, places in families.items()
        # Only unbroken counts from 0 or 1 are families.
        if sorted(places) == list(range(min(places), min(places) + len(places))) and min(places) in (0, 1)
    }
