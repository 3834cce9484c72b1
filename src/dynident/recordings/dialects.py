"""How a CSV file is written: told from its first lines."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

from dynident.recordings.types import RecordingError

_NUMBER = re.compile(r"^[+-]?(\d+([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?$")
_UNIT = re.compile(r"^[\[(]?[A-Za-zµμ°%‰·*./^²0-9 -]{0,12}[\])]?$")
_LOOKED_AT = 1 << 16


@dataclass(frozen=True)
class Dialect:
    """How a CSV file is written; `units` are those of a line of units below the names."""

    delimiter: str
    decimal_point: str
    names: tuple[str, ...]
    lines_before_data: int
    units: dict[str, str] = field(default_factory=dict)


def csv_dialect(path: Path) -> Dialect:
    """Tell separator, decimal sign and column names of a CSV file from its first lines.

    Without a line of names columns are called column1, column2, ….

    Raises
    ------
    RecordingError
        For a file that is no text, or holds nothing, or a name twice.
    """
    with path.open("rb") as file:
        start = file.read(_LOOKED_AT)
    if b"\0" in start:
        raise RecordingError(
            "The file is neither Parquet nor text, nor of another format that is known.", title="Unreadable file"
        )
    lines = _text(start).splitlines()
    header = next((number for number, line in enumerate(lines) if line.strip(" \t#%")), None)
    if header is None:
        raise RecordingError("The file holds no line of column names.", title="Unreadable file")
    # Further comment lines may stand before the names; the names are the last of them.
    while header + 1 < len(lines) and lines[header + 1].lstrip().startswith(("#", "%")):
        header += 1
    if lines[header].lstrip().startswith(("#", "%")) and _is_comment(lines, header):
        header += 1
    text = lines[header].lstrip("#% ").rstrip("\r\n")
    if _is_data(text):
        delimiter, comma = _of_numbers([line for line in lines[header : header + 20] if line.strip()])
        names = tuple(f"column{index + 1}" for index in range(len(_fields(text, delimiter))))
        return Dialect(delimiter, "," if comma else ".", names, header)
    delimiter = _most(text)
    names = tuple(name.strip().strip('"').strip() for name in text.split(delimiter))
    repeated = {name for name, count in Counter(names).items() if name and count > 1}
    if repeated:
        raise RecordingError(f"Column {min(repeated)} stands more than once in the file.", pointer=min(repeated))
    units = _units(lines, header + 1, delimiter, names)
    first = header + 1 + bool(units)
    data = [line for line in lines[first : first + 20] if line.strip()]
    fields = [one for line in data for one in _fields(line, delimiter)]
    comma = delimiter != "," and any("," in one and _NUMBER.match(one) for one in fields)
    return Dialect(delimiter, "," if comma else ".", names, first, units)


def _text(start: bytes) -> str:
    try:
        return start.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        # The last character may be cut off; else it is what Windows writes in western Europe.
        cut = error.start >= len(start) - 4
        return start[: error.start].decode("utf-8-sig") if cut else start.decode("cp1252", errors="replace")


def _most(text: str) -> str:
    delimiter = max(",;\t|", key=text.count)
    if text.count(delimiter) == 0:
        delimiter = " " if " " in text.strip() else ","
    return delimiter


def _fields(line: str, delimiter: str) -> list[str]:
    return [one.strip().strip('"') for one in line.split(delimiter)]


def _is_data(text: str) -> bool:
    """Whether a line holds numbers and nothing else."""
    return any(
        any(fields := [one for one in _fields(text, delimiter) if one]) and all(_NUMBER.match(one) for one in fields)
        for delimiter in ";\t| ,"
    )


def _is_comment(lines: list[str], header: int) -> bool:
    """Whether the last line of comment is prose, and the names follow it: it has other fields than the next lines."""
    if header + 2 >= len(lines) or _is_data(lines[header + 1]):
        return False
    text = lines[header].lstrip("#% ")
    below = lines[header + 1]
    return len(_fields(text, _most(below))) != len(_fields(below, _most(below)))


def _of_numbers(lines: list[str]) -> tuple[str, bool]:
    """Tell separator and decimal comma where there are numbers alone."""
    text = lines[0]
    for delimiter in ";\t|":
        if delimiter in text:
            return delimiter, "," in text
    if " " in text.strip() and ", " not in text:
        return " ", "," in text
    return ",", False


def _units(lines: list[str], number: int, delimiter: str, names: tuple[str, ...]) -> dict[str, str]:
    """The units below the names: a line of as many short words, and a line of numbers below it."""
    if number + 1 >= len(lines) or not _is_data(lines[number + 1]) or _is_data(lines[number]):
        return {}
    fields = _fields(lines[number].lstrip("#% "), delimiter)
    if len(fields) != len(names) or not all(_UNIT.match(one) for one in fields):
        return {}
    if any(one and _NUMBER.match(one) for one in fields) or any(
        one.casefold() in ("nan", "null", "none") for one in fields
    ):
        return {}
    return {name: one.strip("[]() ") for name, one in zip(names, fields, strict=True) if one.strip("[]() -")}
