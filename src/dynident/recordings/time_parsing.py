"""Times that are written as text (dates, hours of a day, durations with a unit), as seconds."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from datetime import date

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from dynident.array_types import FloatArray
from dynident.recordings.arrow import from_numbers, to_floats

_NAME = re.compile(
    r"(?:^|[^a-z])(?:t|time|timestamp|stamp|zeit|secs?|seconds)(?:[ _.]*[\[(]?(?:s|secs?|seconds|ms|us|µs|ns)[\])]?)?$",
    re.IGNORECASE,
)
_DAY = 86_400.0
_CLOCK = (
    r"^\s*(?:(?P<date>\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/. ](?:\d{1,2}|[A-Za-z]{3})[-/. ]\d{4})[T _,]+)?"
    r"(?:(?P<days>\d+) days?,? )?"
    r"(?P<hours>\d{1,2}):(?P<minutes>\d{2})(?::(?P<seconds>\d{1,2}(?:[.,:]\d+)?))?"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2})?\s*$"
)
"""2025-05-06T10:20:30.005+02:00, 06.05.2025 10:20:30,005, 5/6/2025 1:20:30 PM, 10:20:30.005, 0 days 00:00:01.5."""
_DURATION = r"^\s*(?P<value>[+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*(?P<unit>seconds|second|secs|sec|s|ms|us|ns|min)\s*$"
"""0.005 sec, as MATLAB writes the times of a timetable."""
_SECONDS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def is_time_name(name: str) -> bool:
    """Return whether a column's name is that of a time."""
    return _NAME.search(name) is not None


def are_times(cells: Sequence[str]) -> bool:
    """Return whether all cells that are not empty are times."""
    filled = [cell for cell in cells if cell]
    return bool(filled) and any(all(re.match(form, cell) for cell in filled) for form in (_CLOCK, _DURATION))


def parse_seconds(column: pa.Array) -> pa.Array:
    """Return written times as float64: seconds, from 1970 if there is a date; what is no time is missing."""
    clock = pc.extract_regex(column, _CLOCK)
    # No cell is a time of day: they may be durations with a unit.
    if clock.null_count == len(clock):
        return _parse_durations(pc.extract_regex(column, _DURATION))
    hours, minutes, days = (_parse_numbers(clock, name) for name in ("hours", "minutes", "days"))
    total = 3600.0 * hours + 60.0 * minutes + _parse_numbers(clock, "seconds") + _DAY * days
    # East of Greenwich clocks are ahead of UTC: the zone is taken off.
    total += _map_texts(clock, "date", _convert_date) - _map_texts(clock, "zone", _convert_zone)
    half = _map_texts(clock, "half", lambda text: 1.0 if text.casefold() == "pm" else 2.0)
    # 12 AM is midnight, and 12 PM noon.
    total += np.where((half == 1.0) & (hours < 12), 43_200.0, 0.0) - np.where(
        (half == 2.0) & (hours == 12), 43_200.0, 0
    )
    # A cell that is no time would otherwise count as zero.
    total[~np.asarray(pc.is_valid(clock).to_numpy(zero_copy_only=False))] = np.nan
    return from_numbers(total)


def _parse_durations(parts: pa.Array) -> pa.Array:
    return from_numbers(
        _parse_numbers(parts, "value", np.nan) * _map_texts(parts, "unit", lambda unit: _SECONDS.get(unit, 1.0))
    )


def _parse_numbers(parts: pa.Array, name: str, absent: float = 0.0) -> FloatArray:
    """Return (m,): a part of the texts as numbers, `absent` where it is not there."""
    # Some write fractions of a second behind a comma or a colon.
    text = pc.replace_substring_regex(pc.struct_field(parts, name), "[,:]", ".")
    numbers = pc.if_else(pc.match_substring_regex(text, r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$"), text, None)
    return to_floats(numbers.cast(pa.float64()).fill_null(absent)).copy()


def _map_texts(parts: pa.Array, name: str, seconds: Callable[[str], float]) -> FloatArray:
    """Return (m,): what a part of the texts means, computed once for each of the few different texts."""
    column = pc.struct_field(parts, name).fill_null("")
    encoded = pc.dictionary_encode(column)
    values = np.array([seconds(text) if text else 0.0 for text in encoded.dictionary.to_pylist()])
    return np.asarray(values[encoded.indices.to_numpy(zero_copy_only=False)], dtype=np.float64)


def _convert_date(text: str) -> float:
    parts = re.split(r"[-/. ]", text)
    if len(parts[0]) == 4:
        year, month, day = (int(part) for part in parts)
    else:
        year = int(parts[2])
        first, second = int(parts[0]), parts[1].casefold()
        if second in _MONTHS:
            day, month = first, _MONTHS.index(second) + 1
        # Slashes mean the American order, month first, unless that is impossible.
        elif "/" in text and first <= 12:
            month, day = first, int(second)
        else:
            day, month = first, int(second)
    try:
        return (date(year, month, day) - date(1970, 1, 1)).days * _DAY
    except ValueError:
        # Such as the 31st of June: the cell is no date.
        return np.nan


def _convert_zone(text: str) -> float:
    if text[0] not in "+-":
        return 0.0
    minutes = 60 * int(text[1:3]) + int(text[-2:])
    return 60.0 * (minutes if text[0] == "+" else -minutes)
