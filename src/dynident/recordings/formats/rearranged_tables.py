"""Rearrange text whose rows are not moments: a row for each value, a row for each signal, titled blocks of rows.

All of it is rewritten as a table, while it is read. Tables with a row for each value are joined on time afterwards, by
`cells_without_numbers` and `join_stacked_series`.
"""

from __future__ import annotations

import csv
import io
import re
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import pc
from dynident.recordings.cells_without_numbers import find_label_columns, join_labels
from dynident.recordings.file_size_limits import (
    MOST_COLUMNS,
    MOST_UNPACKED,
    TITLE,
    check_columns,
)
from dynident.recordings.file_source import FileSource, to_float_column
from dynident.recordings.formats.csv_and_parquet import StackedSource
from dynident.recordings.formats.printed_records import LineStream
from dynident.recordings.formats.text_streams import TextContent, decode_text
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.time_columns import is_time_name
from dynident.recordings.units import are_times

Rearrange = Callable[[Iterator[str]], Iterator[str]]

_LOOKED_AT = 1 << 16
_FEWEST_ROWS = 8
_NUMBER = re.compile(r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?")
_LIST = re.compile(r"\s*[\[({](.*)[\])}]\s*")
_BETWEEN = re.compile(r"[\s,;]+")
_ANNOTATION = re.compile(r'"?#(?:group|datatype|default)"?,')
_HEAD = "time,signal,value"


def rearrange_table(content: TextContent) -> tuple[TextContent, tuple[str, ...]]:
    """Return the text with a row for each moment or value, if its rows are something else; else the same object.

    Annotated tables of InfluxDB, lists of keys with values, lines of signals, and blocks with titles are rewritten.

    Parameters
    ----------
    content : TextContent
        The file.

    Returns
    -------
    content : TextContent
        The text; reading it raises `RecordingError` where more than fits into memory has to be sorted.
    remarks : tuple of str
        What was done.

    Raises
    ------
    RecordingError
        For bytes that are no text.
    """
    start = content.read_start(_LOOKED_AT)
    text, encoding = decode_text(start)
    rearrange, remark = _find_rearrangement(text.splitlines(), content, len(start) == _LOOKED_AT)
    if rearrange is None:
        return content, ()
    encoding = "utf-8-sig" if encoding == "utf-8" else encoding
    rewritten = content.replace_text(lambda: io.BufferedReader(_open_rearranged(content, rearrange, encoding), 1 << 20))
    return rewritten, (remark,)


def _find_rearrangement(lines: list[str], content: TextContent, is_cut: bool) -> tuple[Rearrange | None, str]:
    if len(lines) > 1 and _ANNOTATION.match(lines[0]):
        return _read_annotated, "The file is an answer of InfluxDB: the lines that describe its tables are left out."
    if (delimiter := _find_signal_rows(lines, content, is_cut)) is not None:
        return partial(_transpose, delimiter=delimiter), "The file has a row for each signal: the table is transposed."
    whole = lines[:-1] if is_cut else lines
    if (delimiter := _find_value_rows(whole)) is not None:
        remark = "Each row is a value: those that are no numbers are left out."
        return partial(_read_value_rows, delimiter=delimiter), remark
    if (head := _find_titled_head(whole)) is not None and _has_further_blocks(content, head):
        remark = "Blocks with titles stand one below another: each has signals of its own."
        return partial(_read_blocks, head=head), remark
    if (key := _find_key_of_names(whole, content)) is not None:
        remark = f"Blocks of times and values stand one below another: each is named by the {key} above it."
        return partial(_read_named_blocks, key=key), remark
    return None, ""


def _open_rearranged(content: TextContent, rearrange: Rearrange, encoding: str) -> LineStream:
    file = content.open()
    lines = io.TextIOWrapper(file, encoding=encoding, errors="replace")
    return LineStream(file, rearrange(line.rstrip("\r\n") for line in lines))


def _read_cells(line: str, delimiter: str) -> list[str]:
    if '"' not in line:
        return [cell.strip() for cell in line.split(delimiter)]
    return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter, skipinitialspace=True), [""])]


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell) is not None


def _write_name(name: str) -> str:
    """Return the name of a signal as a plain cell."""
    return " ".join(re.sub('[,"]', " ", name).split())


_OF_QUERIES = frozenset({"", "result", "table", "_start", "_stop", "_time", "_value", "_field"})
"""Columns of an answer of InfluxDB that name no signal; the others are its measurement and its tags."""
_OF_VALUES = frozenset({"_time", "_value", "_field"})
"""Columns that its tables need, if they have a row for each value."""


def _read_annotated(lines: Iterator[str]) -> Iterator[str]:
    """Yield time, name and value of the numbers in InfluxDB's annotated tables, or the table that a pivot has made."""
    names: list[str] = []
    labels: list[int] = []
    is_long: bool | None = None
    for line in lines:
        cells = _read_cells(line, ",")
        if cells[0].startswith("#") or not any(cells):
            names = []  # A table of other columns may follow.
        elif not names:
            names = cells
            labels = [place for place, name in enumerate(names) if name not in _OF_QUERIES]
            if is_long is None:
                is_long = "_value" in names
                yield _HEAD.replace("time", "_time") if is_long else line
            if missing := sorted(_OF_VALUES - set(names)) if is_long or "_value" in names else []:
                raise RecordingError(
                    f"The file is an answer of InfluxDB, and a table of it lacks {' and '.join(missing)}: keep _time, "
                    "_value and _field of each value, or give each moment one row, by "
                    'pivot(rowKey: ["_time"], columnKey: ["_field"], valueColumn: "_value").',
                    title=TITLE,
                )
        elif not is_long:
            yield line
        elif len(cells) == len(names) and _is_number(value := cells[names.index("_value")]):
            tags = [cells[place] for place in labels if cells[place]]
            name = ".".join((*tags, cells[names.index("_field")]))
            yield f"{cells[names.index('_time')]},{_write_name(name)},{value}"


_OF_KEYS = re.compile(r"(?:key|signal|name|variable|channel|topic)s?(?:[ _]?name)?", re.IGNORECASE)
_OF_NUMBERS = re.compile(r"values?", re.IGNORECASE)


def _are_keys(rows: Sequence[Sequence[str]], head: Sequence[str]) -> bool:
    """Return whether the second cells name signals, by the line of names or because most of the times have several.

    A word that says something of a whole row, such as how it moves, stands once for each time.
    """
    words = defaultdict[str, set[str]](set)
    for time, word, *_ in rows:
        words[time].add(word)
    are_named = len(head) > 2 and _OF_KEYS.fullmatch(head[1]) and _OF_NUMBERS.fullmatch(head[2])
    return bool(are_named) or 2 * sum(len(words[row[0]]) > 1 for row in rows) > len(rows)


def _find_value_rows(lines: Sequence[str]) -> str | None:
    """Return what separates time, key and value, where some values are lists, or a type stands behind them; or None."""
    rows_of_text = [line for line in lines if line.strip()][:400]
    for delimiter in "|;\t,":
        rows = [_read_cells(line, delimiter) for line in rows_of_text]
        if len(rows) < _FEWEST_ROWS or any(len(row) != len(rows[-1]) for row in rows) or len(rows[-1]) not in (3, 4):
            continue
        has_head = not (_is_number(rows[0][0]) or are_times([rows[0][0]]))
        body = rows[has_head:]
        are_keys = not any(_is_number(row[1]) or not row[1] for row in body) and len({row[1] for row in body}) > 1
        if not are_keys or not _are_keys(body, rows[0] if has_head else ()):
            continue
        if not (all(_is_number(row[0]) for row in body) or are_times([row[0] for row in body])):
            continue
        has_lists = sum(_LIST.fullmatch(row[2]) is not None for row in body) > 1
        if len(rows[-1]) == 3 and has_lists and not any(row[2].startswith("{") for row in body):
            return delimiter
        # A type behind each value is a word, the same for all values of a key; else it may be the other half of a key.
        has_types = len(rows[-1]) == 4 and not any(_is_number(row[3]) for row in body) and not has_head
        has_types = has_types and len({(row[1], row[3]) for row in body}) == len({row[1] for row in body})
        if has_types and any(_is_number(row[2].replace(",", ".")) for row in body):
            return delimiter
    return None


def _read_value_rows(lines: Iterator[str], delimiter: str) -> Iterator[str]:
    """Yield time, name and value of each number, those of lists with their places in the names."""
    has_head = False
    types: dict[str, str] = {}
    for line in lines:
        cells = _read_cells(line, delimiter)
        if len(cells) < 3:
            continue
        if not has_head:
            has_head = True
            if not (_is_number(cells[0]) or are_times([cells[0]])):
                value = "value" if _OF_NUMBERS.fullmatch(cells[2]) else _write_name(cells[2])
                yield f"{_write_name(cells[0])},signal,{value}"
                continue
            yield _HEAD
        if len(cells) > 3 and types.setdefault(cells[1], cells[3]) != cells[3]:
            raise RecordingError(
                f"Each row has a time, a key, a value and a word, and the word of {cells[1]} is {types[cells[1]]} in "
                f"some rows and {cells[3]} in others: write names above the columns, or one key for each signal.",
                title=TITLE,
            )
        name, listed = _write_name(cells[1]), _LIST.fullmatch(cells[2])
        if listed is None:
            value = cells[2] if delimiter == "," else cells[2].replace(",", ".")
            if _is_number(value):
                yield f"{cells[0]},{name},{value}"
            continue
        for place, item in enumerate(_BETWEEN.split(listed[1].strip()), start=1):
            if _is_number(item):
                yield f"{cells[0]},{name}_{place},{item}"


_WIDEST = 64
"""Signals of a table that lies on its side: it has a line for each, and many more numbers in every line."""
_UNNAMED = 1000
"""Numbers in each of few rows without names from which on they are moments: no robot has so many signals."""


def _find_signal_rows(lines: list[str], content: TextContent, is_cut: bool) -> str | None:
    """Return what separates the numbers of lines that each hold a signal, or None.

    Each line begins with a name, the first one with that of the time; or the whole file has no names, and few lines of
    many numbers each. The first bytes of such a file may hold few lines, and the last one in part.
    """
    if not lines or (is_cut and len(lines) > _WIDEST):
        return None
    for delimiter in ",;\t|":
        first = _read_cells(lines[0], delimiter)
        numbers = first[1 : -1 if is_cut and len(lines) == 1 else None]
        if len(numbers) >= _UNNAMED and _is_number(first[0]) and _has_few_long_rows(content, delimiter):
            return delimiter
        if len(numbers) <= max(2 * _FEWEST_ROWS, 2 * len(lines)) or not all(map(_is_number, numbers)):
            continue
        is_rising = all(float(after) > float(before) for before, after in pairwise(numbers))
        others = [_read_cells(line, delimiter) for line in lines[1:] if line.strip()]
        are_named = all(not _is_number(row[0]) and all(map(_is_number, row[1:-1])) for row in others)
        if is_rising and is_time_name(first[0]) and are_named:
            return delimiter
    return None


def _has_few_long_rows(content: TextContent, delimiter: str) -> bool:
    """Return whether a whole file has few lines, all of equally many numbers: a camera's rows are long, too, but many.

    Only the whole file tells: of long lines the first bytes hold few in any case.
    """
    encoding = decode_text(content.read_start(_LOOKED_AT))[1]
    widths = set[int]()
    with content.open() as file:
        lines = (line for line in io.TextIOWrapper(file, encoding=encoding, errors="replace") if line.strip())
        for number, line in enumerate(lines):
            cells = _read_cells(line.lstrip("\ufeff"), delimiter)
            widths.add(len(cells))
            if number == _WIDEST or len(widths) > 1 or not all(map(_is_number, cells)):
                return False
    return True


def _check_size(size: int, n_rows: int = 0) -> None:
    """Refuse more characters than are held in memory at once, or more signals than columns."""
    if size > MOST_UNPACKED // 4 or n_rows > MOST_COLUMNS:
        raise RecordingError(
            "The file has a row for each signal, or blocks of rows one below another, and is too large to be sorted: "
            "write a row for each moment, with a column for each signal.",
            title=TITLE,
        )


def _transpose(lines: Iterator[str], delimiter: str) -> Iterator[str]:
    rows, size = list[list[str]](), 0
    for line in lines:
        if line.strip():
            rows.append(_read_cells(line, delimiter))
        size += len(line)
        _check_size(size, len(rows))
    width = max(map(len, rows))
    is_named = not _is_number(rows[0][0])
    if is_named:
        yield ",".join(_write_name(row[0]) for row in rows)
    for place in range(int(is_named), width):
        yield ",".join(row[place] if place < len(row) else "" for row in rows)


_UNIT = re.compile(r"\W*units?\W*[:=]\s*(\S.*?)\W*$", re.IGNORECASE)
_OF_KEY = re.compile(r"\s*[\w ]+[:=]")


def _find_titled_head(lines: Sequence[str]) -> str | None:
    """Return the line of names above the first row of numbers, if lines without such cells stand above it; or None."""
    for number, line in enumerate(lines[:64]):
        delimiter = next((sign for sign in "\t;,|" if sign in line), None)
        if delimiter is None or number + 2 >= len(lines):
            continue
        names, below = _read_cells(line, delimiter), _read_cells(lines[number + 1], delimiter)
        is_head = len(names) > 2 and len(below) == len(names) and all(map(_is_number, below))
        if is_head and is_time_name(re.sub(r"\s*[\[(].*", "", names[0])) and not any(map(_is_number, names)):
            above = [text for text in lines[:number] if text.strip()]
            are_titles = all(delimiter not in text for text in above) and any(not _OF_KEY.match(text) for text in above)
            return line if above and are_titles else None
    return None


_WORDS_OF_TITLE = re.compile(r"(?:joint|axis)\W*\d+|[^\W\d_]{2,}", re.IGNORECASE)
"""What a title says of its signals. Numbers, letters and stamps of time count runs, except behind the word joint."""


def _has_further_blocks(content: TextContent, head: str) -> bool:
    """Return whether the names stand again in the file, above rows of the same times and below titles of other words.

    Blocks of other times, or with titles that only count, are runs of the same signals.
    """
    delimiter = next(sign for sign in "\t;,|" if sign in head)
    titles: list[tuple[str, ...]] = []
    times: list[list[str]] = []  # the first two and the last of each block
    with content.open() as file:
        above: list[str] = []
        for line in io.TextIOWrapper(file, encoding="utf-8", errors="replace"):
            first, sign, _ = line.partition(delimiter)
            if line.rstrip("\r\n") == head:
                titles.append(tuple(_WORDS_OF_TITLE.findall(_read_title(above)[0].lower())))
                times.append([])
                above = []
            elif sign and _is_number(time := first.strip(' "')):
                above = []
                if times:
                    times[-1][2:] = [time]
            elif line.strip():
                above.append(line)
    if len(titles) < 2 or len(set(titles)) < len(titles) or any(len(block) < 3 for block in times):
        return False
    begins, seconds, ends = zip(*(map(float, block) for block in times), strict=True)
    # The signals may have rates of their own: the last row of one may be missing in another.
    step = max(second - begin for begin, second in zip(begins, seconds, strict=True))
    return len(set(begins)) == 1 and max(ends) - min(ends) < 1.5 * step


def _read_title(above: Sequence[str]) -> tuple[str, str]:
    """Return the title and the unit of a block, from the lines above its names."""
    units = [match[1] for line in above if (match := _UNIT.match(line)) is not None]
    titles = [line for line in above if not _OF_KEY.match(line)]
    return (re.sub(r"[^\w()%/. -]+", " ", titles[-1]).strip() if titles else ""), (units[-1] if units else "")


def _read_blocks(lines: Iterator[str], head: str) -> Iterator[str]:
    """Yield time, name and value of blocks of rows, one signal below another, with their titles in the names."""
    delimiter = next(sign for sign in "\t;,|" if sign in head)
    time, *names = _read_cells(head, delimiter)
    yield _HEAD.replace("time", _write_name(time))
    above: list[str] = []
    rows: list[list[str]] = []
    title, unit, size = "", "", 0

    def write_block() -> Iterator[str]:
        for place, name in enumerate(names, start=1):
            label = _write_name(f"{title} {name}") + (f" [{_write_name(unit)}]" if unit else "")
            for row in rows:
                yield f"{row[0]},{label},{row[place]}"

    for line in lines:
        if line == head:
            yield from write_block()
            (title, unit), rows, above, size = _read_title(above), [], [], 0
            continue
        cells = _read_cells(line, delimiter)
        if len(cells) == len(names) + 1 and all(map(_is_number, cells)):
            rows.append(cells)
            size += len(line)
            _check_size(size)
        elif line.strip():
            above.append(line)
    yield from write_block()


def join_stacked_series(source: FileSource) -> FileSource:
    """Return the file with a column for each signal, if the signals stand one below another; else the same object.

    Raises
    ------
    RecordingError
        For more rows than fit into memory.
    """
    labels, columns, _ = find_label_columns(source, source.texts)
    time = next(filter(is_time_name, source.names), None)
    if not labels or not columns or time is None or any(len(set(source.texts[name])) > 1 for name in labels):
        return source
    parts: dict[str, list[FloatArray]] = {}
    last, last_time, first_row, n_bytes = "", np.nan, 0, 0
    for batch in source.batches([time, *columns, *labels]):
        table = np.column_stack([to_float_column(batch, name, first_row) for name in (time, *columns)])
        coded = pc.dictionary_encode(join_labels([batch.column(name) for name in labels]))
        codes = coded.indices.to_numpy(zero_copy_only=False)
        edges = [0, *(np.flatnonzero(np.diff(codes)) + 1).tolist(), len(codes)] if len(codes) else []
        for begin, end in pairwise(edges):
            name = coded.dictionary[codes[begin]].as_py()
            # A signal that comes again is one of rows that take turns, or of another run; where time goes on, the word
            # says something of the rows, such as how they move.
            if parts and name != last and (name in parts or not table[begin, 0] < last_time):
                return source
            parts.setdefault(name, []).append(table[begin:end])
            last, last_time = name, table[end - 1, 0]
        first_row, n_bytes = first_row + batch.num_rows, n_bytes + table.nbytes
        if n_bytes > _MOST_STACKED:
            if len(parts) > 1:
                raise _make_stacked_error()
            parts[last].clear()  # it may be the only one, and is too long to be held beside another
    if len(parts) < 2:
        return source
    series = {name: np.concatenate(tables) for name, tables in parts.items()}
    spans = [(table[0, 0], table[-1, 0]) for table in series.values()]
    if any(len(table) < _FEWEST_SAMPLES or not (np.diff(table[:, 0]) >= 0.0).all() for table in series.values()) or max(
        begin for begin, _ in spans
    ) >= min(end for _, end in spans):
        return source
    check_columns(1 + len(series) * len(columns))
    # Many short signals beside a long one would become far more numbers than the file has.
    if 8 * max(map(len, series.values())) * len(series) * len(columns) > max(MOST_UNPACKED, 2 * n_bytes):
        raise _make_stacked_error()
    return StackedSource(source, time, series, columns)


def _make_stacked_error() -> RecordingError:
    return RecordingError(
        "The signals stand one below another, in too many rows to be sorted: write a row for each moment, with a "
        "column for each signal (pandas: df.pivot).",
        title=TITLE,
    )


_MOST_STACKED, _FEWEST_SAMPLES = 1 << 30, 8
"""Bytes of the numbers of a table whose signals stand one below another, as it is held in memory; and rows of each."""


_NAMED = re.compile(r"\s*(?:\d+\.)?(variable|symbol|signal|channel|name)\s*[;:=,\t]\s*(\S.*?)[\s;,]*$", re.IGNORECASE)
"""A key of the signal of a block, as traces of CODESYS have it: `0.Variable; PLC.Axis1.fActPos`."""
_TIME_UNIT = re.compile(r"\s*time\W?unit\s*[;:=,\t]\s*(\w{1,12})[\s;,]*$", re.IGNORECASE)
_MOMENT = re.compile(rf"\s*[;\t]?\s*({_NUMBER.pattern})\s*[;\t]\s*({_NUMBER.pattern})[\s;]*$")
"""A row of such a block: time and value."""


def _find_key_of_names(lines: Sequence[str], content: TextContent) -> str | None:
    """Return the key that names blocks of times and values, each signal below another; None where there is none."""
    first = next((number for number, line in enumerate(lines) if _MOMENT.match(line)), len(lines))
    rows = lines[first : first + _FEWEST_ROWS]
    if len(rows) < _FEWEST_ROWS or not all(map(_MOMENT.match, rows)) or not any(map(_NAMED.match, lines[:first])):
        return None
    names: dict[str, set[str]] = defaultdict(set)
    with content.open() as file:
        for line in io.TextIOWrapper(file, encoding="utf-8", errors="replace"):
            if (match := _NAMED.match(line)) is not None:
                names[match[1].casefold()].add(match[2])
    # The trace as a whole has a name as well.
    repeated = [key for key in ("variable", "symbol", "signal", "channel", "name") if len(names[key]) > 1]
    return repeated[0] if repeated else None


def _read_named_blocks(lines: Iterator[str], key: str) -> Iterator[str]:
    """Yield time, name and value of blocks of times and values below the keys that describe them."""
    head, name = _HEAD, ""
    for line in lines:
        if (moment := _MOMENT.match(line)) is not None:
            if head:
                yield head
                head = ""
            yield f"{moment[1]},{name},{moment[2]}"
        elif (named := _NAMED.match(line)) is not None and named[1].casefold() == key:
            name = _write_name(named[2])
        elif head and (unit := _TIME_UNIT.match(line)) is not None:
            head = _HEAD.replace("time", f"time [{unit[1]}]")
