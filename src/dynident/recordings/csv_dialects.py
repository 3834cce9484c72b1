"""Detect separator, decimal sign, header, units and words for empty cells of a CSV file from its first lines."""

from __future__ import annotations

import csv
import itertools
import re
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from dynident.recordings.cells_without_numbers import make_counted_names
from dynident.recordings.file_source import fill_blank_names
from dynident.recordings.formats import packed_messages
from dynident.recordings.formats.text_streams import (
    CHANGES_OF_CELLS,
    count_list_items,
    decode_text,
    flatten_lists,
    has_lists,
    join_open_lists,
    number_repeated_names,
    pair_times,
    squeeze_spaces,
)
from dynident.recordings.recording_metadata import RecordingError
from dynident.recordings.time_columns import is_time_name

_NUMBER = re.compile(r"^[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$")
_WRITTEN_TIME = re.compile(
    r"^(?:\d{1,4}([-/.])\d{1,2}\1\d{1,4}(?:[T _]+(?=\d+:)|$)|\d{8}[T _](?=\d+:))?"
    r"(?:\d{1,2}:\d{2}(?::\d{2}(?:[.,:]\d+)?)?(?:Z|[+-]\d{2}:?\d{2})?)?$"
)
_ENGLISH = re.compile(r"^[+-]?\d{1,3}(?:,\d{3})+\.\d*$")  # commas between thousands, and a decimal point
_UNIT = re.compile(r"^[\[(]?[A-Za-zµμ°%‰·*./^²0-9 -]{0,12}[\])]?$")
_NESTED = re.compile(r"[\[(]\s*[\[(][^\]\[()]*[\])]?\s*,\s*[\[(]|[\[(]\s*[\[(][-+.\d][^\]\[()]*,\s*[\[(]")
_TUPLE = re.compile(r"^\(.*\)$")
dialect_bytes = 1 << 16  # of a file that are looked at
_ROWS = 200
_NO_NUMBERS = ("nan", "-nan", "inf", "-inf", "na", "n/a", "null", "none")


@dataclass(frozen=True)
class Dialect:
    """How a CSV file is written.

    `units` are those of a line of units below the names, `texts` the first cells of columns that hold words. `rewrite`
    and `encoding` say how its lines become plain ones. `has_gaps`: cells of the first rows are empty. `clocks` has the
    column of time of every column that has its own. `remarks` say what is not plain.
    """

    delimiter: str
    decimal_point: str
    names: tuple[str, ...]
    lines_before_data: int
    units: dict[str, str] = field(default_factory=dict)
    texts: dict[str, tuple[str, ...]] = field(default_factory=dict)
    rewrite: tuple[Callable[[str], str], ...] = ()
    encoding: str = "utf-8"
    has_gaps: bool = False
    clocks: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


@dataclass
class _Header:
    """Names, the number of lines above the first row, units, and columns with their own time."""

    names: tuple[str, ...]
    lines: int
    units: dict[str, str] = field(default_factory=dict)
    clocks: dict[str, str] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()


def detect_dialect(start: bytes) -> Dialect:
    """Return the dialect of a CSV file, by its first bytes.

    Without a line of names columns are called column1, column2, ….

    Parameters
    ----------
    start : bytes
        The first `dialect_bytes` of the file.

    Returns
    -------
    Dialect
        What is needed to read the file.

    Raises
    ------
    RecordingError
        For a file that is no text, or holds nothing.
    """
    text, encoding = decode_text(start)
    rewrite: list[Callable[[str], str]] = []
    for applies, change in CHANGES_OF_CELLS:
        if applies(text):
            text = change(text)
            rewrite.append(change)
    original = text.splitlines()
    if len(start) == dialect_bytes and len(original) > 1:
        original.pop()  # it is cut off
    whole = join_open_lists(original)
    if any(_NESTED.search(line) for line in whole[1:4]):
        raise RecordingError(
            'Cells hold lists within lists: write a column for each number, or lists of one signal, "[0.1, 0.2]".',
            title="Unreadable file",
        )
    if has_lists(whole):
        original = whole
        rewrite.append(flatten_lists)
    lines = flatten_lists("\n".join(original)).splitlines() if flatten_lists in rewrite else original
    if (form := packed_messages.find_line_form(lines)) is not None:
        names, separate, remark = form
        texts = _collect_texts([_split_fields(line, ",") for line in separate("\n".join(lines)).splitlines()], names)
        return Dialect(
            ",", ".", names, 0, texts=texts, rewrite=(*rewrite, separate), encoding=encoding, remarks=(remark,)
        )
    if _is_aligned(lines):
        rewrite.append(squeeze_spaces)
        lines = squeeze_spaces("\n".join(lines)).splitlines()
    first = next((number for number, line in enumerate(lines) if line.strip(" \t#%")), None)
    if first is None:
        raise RecordingError("The file has no line with column names.", title="Unreadable file")
    delimiter, comma, header = _read_header(lines, first)
    if flatten_lists in rewrite:
        header.names = _name_list_columns(header, original, delimiter)
    rows = [_split_fields(line, delimiter) for line in lines[header.lines : header.lines + _ROWS] if line.strip()]
    header.names = _fit_last_name(header.names, rows)
    header.names, guessed = fill_blank_names(header.names)
    header.names, header.clocks = pair_times(header.names) or (header.names, header.clocks)
    header.names, remarks = number_repeated_names(header.names)
    # Lines with another number of cells, such as remarks between the rows, say nothing of the columns.
    rows = [row for row in rows if len(row) == len(header.names)]
    packed_messages.check_message_kinds((texts := _collect_texts(rows, header.names)).get("column1", ()))
    return Dialect(
        delimiter,
        "," if comma else ".",
        header.names,
        header.lines,
        header.units,
        texts,
        tuple(rewrite),
        encoding,
        has_gaps=any(not cell or cell.casefold() in _NO_NUMBERS for row in rows for cell in row),
        clocks=header.clocks,
        remarks=(*header.remarks, *guessed, *remarks),
    )


def _fit_last_name(names: tuple[str, ...], rows: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return names for as many cells as the rows have, where a separator ends either the rows or the names."""
    widths = Counter(map(len, rows)).most_common(1)
    width = widths[0][0] if widths else len(names)
    if width == len(names) + 1 and not any(row[-1] for row in rows if len(row) == width):
        return (*names, f"column{width}")
    # Rows have a name, or a number, of their own: R writes none above them.
    if width == len(names) + 1 and _count_rows([row[0] for row in rows if len(row) == width]):
        return ("row", *names)
    is_surplus = width == len(names) - 1 and (not names[-1] or names[-1].casefold() in _REMARKS)
    return names[:-1] if is_surplus else names


_REMARKS = ("comment", "remark", "kommentar")  # above columns whose cells are mostly left out


def _count_rows(cells: Sequence[str]) -> bool:
    """Return whether cells count rows, or are words."""
    numbers = [int(cell) for cell in cells if cell.isdecimal()]
    if not numbers:
        return not any(map(_is_number, cells))
    return len(numbers) == len(cells) and all(after == before + 1 for before, after in itertools.pairwise(numbers))


_NAMES_OF_CHANNELS = ("symbolname", "name", "signal", "channel", "kanal")  # of a head, the best first


def _read_channel_head(lines: list[str], first: int) -> tuple[str, bool, _Header] | None:
    """Return the names of channels below which stand groups of columns, each with its time first; None for other files.

    Above them stands a key in every column of time, and what it says of the channels in the ones beside it, as a scope
    writes it: `Name;Axis1.Position;Axis2.Position;Name;Axis1.Torque;Axis2.Torque`.
    """
    body = next((number for number in range(first, len(lines)) if _is_data(lines[number])), first)
    if body == first:
        return None
    delimiter = next((sign for sign in "\t;|," if sign in lines[body]), ",")
    width = len(_split_fields(lines[body], delimiter))
    head: dict[str, list[str]] = {}
    clocks = set(range(width))
    for line in lines[first:body]:
        cells = _split_fields(line, delimiter)
        # The last values of a line may be empty, and their separator missing.
        cells += [""] * (width - len(cells)) if len(cells) == width - 1 else []
        if len(cells) == width and cells[0] and cells.count(cells[0]) > 1 and not _is_number(cells[0]):
            head[cells[0].casefold()] = cells
            # A channel may be called as the key is; in all lines together only the columns of time hold the keys.
            clocks &= {place for place, cell in enumerate(cells) if cell == cells[0]}
    channels = [place for place in range(width) if place not in clocks]
    if (len(head) < 2 and clocks != set(range(0, width, 2))) or width < 4 or not head or 0 not in clocks:
        return None
    # Names in two lines repeat words as well, above positions and torques: those are no times.
    below = [row for line in lines[body : body + 20] if len(row := _split_fields(line, delimiter)) == width]
    times = [[row[place].replace(",", ".") for row in below if _NUMBER.match(row[place])] for place in clocks]
    is_rising = all(float(after) > float(before) for own in times for before, after in itertools.pairwise(own))
    if len(clocks) < 2 or not is_rising or any(place + 1 in clocks or place + 1 == width for place in clocks):
        return None
    whole = ([head[key][place] for place in channels] for key in (*_NAMES_OF_CHANNELS, *head) if key in head)
    names = next((values for values in whole if all(values) and len(set(values)) == len(values)), None)
    if names is None:
        return None
    by_place = dict(zip(channels, names, strict=True))
    columns = [by_place.get(place) or f"{by_place[place + 1]}.time" for place in range(width)]
    clock_of = {by_place[place]: columns[max(clock for clock in clocks if clock < place)] for place in channels}
    step = next((key for key in head if key.startswith("sampletime")), "")
    unit = step.partition("[")[2].strip("] ")
    units = dict.fromkeys(clock_of.values(), unit) if unit else {}
    # Units stand with their kind: "° (Angle)", or "(None)".
    stated = {by_place[place]: head["unit"][place].partition("(")[0].strip() for place in channels if "unit" in head}
    units |= {name: unit for name, unit in stated.items() if unit and _UNIT.match(unit)}
    comma = delimiter != "," and any("," in cell and _NUMBER.match(cell) for row in below for cell in row)
    return delimiter, comma, _Header(tuple(columns), body, units, clock_of)


def _read_header(lines: list[str], first: int) -> tuple[str, bool, _Header]:
    """Return the separator, whether numbers have commas, and the names; `first` is the first line with text."""
    if (channels := _read_channel_head(lines, first)) is not None:
        return channels
    header = first
    # Further comment lines may stand before the names; the names are the last of them.
    while header + 1 < len(lines) and lines[header + 1].lstrip().startswith(("#", "%")):
        header += 1
    if lines[header].lstrip().startswith(("#", "%")) and _is_comment(lines, header):
        header += 1
    header = _skip_titles(lines, header)
    text = lines[header].lstrip("#% ").rstrip("\r\n")
    below = [line for line in lines[header : header + 20] if line.strip()]
    is_row = _is_data(text) or _is_marked_row(below)
    # Names and units may have commas: what stands as often between the names as in every row separates both.
    alike = (sign for sign in ";\t|" if len({line.count(sign) for line in (text, *lines[-20:]) if line}) == 1)
    delimiter = next((sign for sign in alike if text.count(sign) > 1), None) or _find_delimiter(text)
    width = Counter(len(_split_fields(line, delimiter)) for line in below).most_common(1)[0][0]
    # Messages of other senders, with fewer joints, may stand between those of the arm. A line of names has no numbers.
    has_numbers = not is_row and any(map(_is_number, _split_fields(text, delimiter)))
    messages = [line for line in below if len(_split_fields(line, delimiter)) == width] if has_numbers else []
    cells = [[None if _is_number(cell) else cell for cell in _split_fields(line, delimiter)] for line in messages[:2]]
    if (names := packed_messages.name_message_columns(cells) or packed_messages.name_value_columns(cells)) is not None:
        return delimiter, False, _Header(names, header)
    # Words between numbers are values, as those of a state, if the next row repeats them or has others there.
    if is_row or (len(cells) > 1 and any(cells[0]) and packed_messages.have_words_alike(cells, text)):
        delimiter, comma = _detect_number_format(below)
        fields = _split_fields(text, delimiter)
        counts = _is_counted(fields) and len(below) > 1 and not _is_counted(_split_fields(below[1], delimiter))
        return delimiter, comma, _Header(make_counted_names("column", len(fields)), header + counts)
    names = tuple(join_name_levels(field) for field in _split_fields(text, delimiter))
    names = _join_merged_heads(names, _split_fields(lines[header - 1], delimiter) if header else [])
    rows = header + 1
    delimiter = _find_delimiter_of_rows(lines[rows : rows + 20], len(names)) or delimiter
    repeats = sum(map(bool, names)) - len({name for name in names if name}) > 1 and rows < len(lines)
    if repeats or _is_second_line_of_names(lines, rows, delimiter, names):
        # Names in two lines: of the signal, which is repeated, and of the joint; or of a channel and what it holds.
        second = _split_fields(lines[rows], delimiter)
        if len(second) == len(names) and all(cell.isdecimal() or not _is_number(cell) for cell in second):
            both = tuple("_".join(part for part in pair if part) for pair in zip(names, second, strict=True))
            if len(set(both)) == len(both):
                names, rows = both, rows + 1
                if rows < len(lines) and 2 * sum(map(bool, _split_fields(lines[rows], delimiter))) < len(names):
                    rows += 1
    units = _read_units(lines, rows, delimiter, names)
    rows += bool(units)
    split = [_split_fields(line, delimiter) for line in lines[rows:]]
    properties = packed_messages.count_properties(split, _is_number)
    for number in range(rows, rows + properties):
        facts = packed_messages.put_word_before(_split_fields(lines[number], delimiter))
        if "unit" in facts[0].casefold():
            units |= _list_units(facts[1:], names[1:])
    rows += properties
    fields = [cell for line in lines[rows : rows + 20] if line.strip() for cell in _split_fields(line, delimiter)]
    # A comma inside a cell can only be a decimal one if something else separates the cells.
    grouped = any(map(_ENGLISH.match, fields))
    comma = delimiter != "," and not grouped and any("," in cell and _NUMBER.match(cell) for cell in fields)
    remarks = (f"{properties} lines below the names say what the columns have, and are no rows.",) if properties else ()
    return delimiter, comma, _Header(names, rows, units, remarks=remarks)


def _join_merged_heads(names: tuple[str, ...], above: Sequence[str]) -> tuple[str, ...]:
    """Return names that repeat with the heads above them, each of which stands over several columns of a sheet."""
    if len(set(names)) == len(names) or len(above) != len(names) or not any(above):
        return names
    # A cell that is empty goes on with the head before it.
    heads = [next(filter(None, above[place::-1]), "") for place in range(len(above))]
    joined = tuple("_".join(filter(None, pair)) for pair in zip(heads, names, strict=True))
    return joined if len(set(joined)) == len(joined) else names


def _find_delimiter(text: str) -> str:
    # The most frequent one; where none is more frequent than the others, the comma.
    delimiter = max(",;\t|", key=text.count)
    return delimiter if delimiter in text or " " not in text.strip() else " "


def _find_delimiter_of_rows(lines: Sequence[str], width: int) -> str | None:
    """Return what separates the numbers of rows, where another sign than that between the names gives as many."""
    rows = [line for line in lines if line.strip()]
    for delimiter in ";\t|, ":
        cells = [_split_fields(line.strip(), delimiter) for line in rows]
        if rows and width > 1 and all(len(row) == width and all(map(_NUMBER.match, row)) for row in cells):
            return delimiter
    return None


def _split_fields(line: str, delimiter: str) -> list[str]:
    if '"' in line:
        # Quotes inside a cell are part of it, as in the names of a PLC: "Robot"."Axis".
        reader = csv.reader([line.strip()], delimiter=delimiter, skipinitialspace=True)
        return [cell.strip() for cell in next(reader, [""])]
    return [cell.strip() for cell in line.split(delimiter)]


def empty_repeated_names(text: str, dialect: Dialect) -> str:
    """Return whole lines; those that repeat the names of the columns, as where runs are put end to end, are empty."""
    lines = text.splitlines(keepends=True)
    for number, line in enumerate(lines):
        # A row begins with a number mostly: most lines are passed by at their first character.
        if line[:1] in "0123456789-+.":
            continue
        fields = [join_name_levels(field) for field in _split_fields(line.strip(), dialect.delimiter)]
        if len(fields) != len(dialect.names):
            continue
        # Rows below such a line are of other signals than their columns are called.
        if fields != list(dialect.names) and sorted(fields) == sorted(dialect.names):
            raise RecordingError(
                f"The names of the columns stand again between the rows, in another order ({', '.join(fields[:4])}, "
                "…): split the file there, and give its parts as two recordings.",
                title="Unreadable file",
            )
        # Units stand below the names there, too: such a line has no number either.
        if 2 * sum(map(str.__eq__, fields, dialect.names)) >= len(fields) or not any(map(_is_number, fields)):
            lines[number] = "\n"
    return "".join(lines)


def join_name_levels(field: str) -> str:
    """Return a column's name; one on several levels, ('q', 1), becomes q_1."""
    if not _TUPLE.match(field) or "," not in field:
        return field
    return "_".join(part for part_text in field[1:-1].split(",") if (part := part_text.strip(" '\"")))


def _is_data(text: str) -> bool:
    """Return whether a line holds numbers, and nothing else but dates and times of day."""
    return any(_is_row(text, delimiter) for delimiter in ";\t| ,")


def _is_marked_row(lines: Sequence[str]) -> bool:
    """Return whether the first line is a row of numbers behind a word that says what it is, and goes on so below."""
    delimiter = _find_delimiter(lines[0]) if lines else ","
    rows = [_split_fields(line, delimiter) for line in lines]
    alike = [row for row in rows if len(row) == len(rows[0]) and row[0] == rows[0][0]]
    is_word = len(alike) > 1 and bool(re.match(r"^[^\W\d_]", rows[0][0])) and len(rows[0]) > 3
    return is_word and all(_is_number(cell) for row in alike for cell in row[1:])


def _is_row(text: str, delimiter: str) -> bool:
    fields = [cell for cell in _split_fields(text, delimiter) if cell and not _WRITTEN_TIME.match(cell)]
    return bool(fields) and all(map(_NUMBER.match, fields))


def _is_counted(fields: Sequence[str]) -> bool:
    """Return whether the fields count the columns from 0, as pandas names those without names."""
    numbers = list(fields[1:] if fields and not fields[0] else fields)
    return len(numbers) > 1 and numbers == [str(number) for number in range(len(numbers))]


def _is_comment(lines: list[str], header: int) -> bool:
    """Return whether the last line of comment is prose: it has other fields than the next lines."""
    text, below = lines[header].lstrip("#% "), lines[header + 1] if header + 2 < len(lines) else ""
    if not below or _is_data(below):
        return False
    return len(_split_fields(text, _find_delimiter(below))) != len(_split_fields(below, _find_delimiter(below)))


def _skip_titles(lines: list[str], header: int) -> int:
    """Return the line of names below titles, which have fewer fields than the rows, or mostly empty ones."""
    # The last lines that were read are surely rows: they tell the width of the table.
    body = [line for line in lines[header:] if line.strip()][-20:]
    if len(body) < 4:
        return header
    delimiter = next((sign for sign in ";\t|" if sign in body[-1]), _find_delimiter(body[-1]))
    width = Counter(len(_split_fields(line, delimiter)) for line in body).most_common(1)[0][0]

    def is_whole(line: str) -> bool:
        fields = _split_fields(line.lstrip("#% "), delimiter)
        is_remarked = len(fields) == width + 1 and fields[-1].casefold() in _REMARKS
        return (len(fields) == width or is_remarked) and 2 * sum(map(bool, fields)) >= len(fields)

    if width < 2 or is_whole(lines[header]):
        return header
    # Rows may have empty cells: names are a line without a number, and of several the one with the fewest empty cells.
    filled = {
        number: sum(map(bool, cells))
        for number, line in enumerate(lines)
        if number > header and is_whole(line) and not any(map(_NUMBER.match, cells := _split_fields(line, delimiter)))
    }
    if filled:
        return max(filled, key=lambda number: (filled[number], -number))
    # Messages of another kind may stand above rows that begin with what they are.
    rows = (number for number in range(header, len(lines)) if is_whole(lines[number]))
    row = next(rows, header)
    # Words that are more or fewer than the columns of numbers below them, with spaces between these, name none.
    text = lines[header].lstrip("#% ")
    is_named = is_time_name(text.split()[0]) or any(
        abs(len(_split_fields(text, sign)) - width) < 2 for sign in ";\t|, "
    )
    is_found = delimiter == " " and not is_named and _is_data(lines[row])
    return row if is_found or _is_marked_row([line for line in lines[row : row + 20] if line.strip()]) else header


def _is_aligned(lines: list[str]) -> bool:
    """Return whether only spaces stand between the columns, several of them, or at the ends of the lines."""
    rows = [line for line in lines if line.strip()][-20:]
    spaced = [line for line in rows if not any(sign in line for sign in ",;|") and " " in line.strip()]
    if not spaced or len(spaced) < len(rows):
        # Commas may be those of numbers.
        spaced = [line for line in rows if " " in line.strip() and all(map(_NUMBER.match, line.split()))]
    tabs_alone = all("\t" in line and " " not in line.replace("\t", "") for line in spaced)
    irregular = any("  " in line or line != line.strip() or "\t" in line for line in spaced)
    return bool(spaced) and len(spaced) == len(rows) and irregular and not tabs_alone


def _detect_number_format(lines: list[str]) -> tuple[str, bool]:
    """Return separator and decimal comma of a file of numbers alone."""
    text = lines[0]
    # A comma with blanks beside it separates points. Otherwise separators that no number contains come first, and a
    # space is one only where it does more than end a comma, or a date.
    cells = _split_fields(text, ",")
    for delimiter in ";\t|":
        if delimiter in text and not (len(cells) > 1 and all(map(_NUMBER.match, cells))):
            return delimiter, "," in text
    if " " in text.strip() and ", " not in text and (_is_row(text, " ") or not _is_row(text, ",")):
        return " ", "," in text
    return ",", False


def _is_number(text: str) -> bool:
    return bool(_NUMBER.match(text)) or text.casefold() in _NO_NUMBERS


def _name_list_columns(header: _Header, original: Sequence[str], delimiter: str) -> tuple[str, ...]:
    """Return the names, with one for every item if the rows have lists below single names."""
    lengths = count_list_items("\n".join(original[header.lines : header.lines + 1]), delimiter)
    # A separator may end the line of names.
    names = header.names if any(header.names[len(lengths) :]) else header.names[: len(lengths)]
    if len(lengths) != len(names) or sum(lengths) == len(lengths):
        return header.names
    return tuple(
        name
        for column, length in zip(names, lengths, strict=True)
        for name in (make_counted_names(column, length) if length > 1 else (column,))
    )


def _collect_texts(rows: Sequence[Sequence[str]], names: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the first cells of columns most of whose cells are words."""
    texts = {}
    for name, cells in zip(names, zip(*(row for row in rows if len(row) == len(names)), strict=True), strict=False):
        words = sum(1 for cell in cells if cell and not _is_number(cell))
        if 2 * words > sum(map(bool, cells)):
            texts[name] = tuple(cells)
    return texts


def _read_units(lines: list[str], number: int, delimiter: str, names: tuple[str, ...]) -> dict[str, str]:
    """Return the units below the names: a line of as many short words, with a line of numbers below it."""
    if number + 1 >= len(lines) or _is_data(lines[number]):
        return {}
    # A word may stand before the units, and another before each row, that says what they are.
    is_marked = _is_marked_row([line for line in lines[number + 1 : number + 20] if line.strip()])
    if not is_marked and not _is_data(lines[number + 1]):
        return {}
    fields = _split_fields(lines[number].lstrip("#% "), delimiter)
    fields[0] = "" if is_marked else fields[0]
    are_units = len(fields) == len(names) and all(_UNIT.match(cell) for cell in fields)
    if not are_units or any(cell and _is_number(cell) for cell in fields):
        return {}
    return _list_units(fields, names)


def _is_second_line_of_names(lines: list[str], number: int, delimiter: str, names: tuple[str, ...]) -> bool:
    """Tell whether words, too long for units, stand below all names that are not ours, and numbers below them."""
    cells = _split_fields(lines[number], delimiter) if number + 1 < len(lines) and _is_data(lines[number + 1]) else []
    are_words = len(cells) == len(names) and all(cell and not _is_number(cell) for cell in cells)
    are_words = are_words and not any(re.fullmatch(r"(q|dq|ddq|tau|current)\d+", name) for name in names)
    return are_words and not _read_units(lines, number, delimiter, names)


def _list_units(cells: Sequence[str], names: Sequence[str]) -> dict[str, str]:
    return {name: cell.strip("[]() ") for name, cell in zip(names, cells, strict=False) if cell.strip("[]() -")}
