"""Units of recordings, by their spellings, and their conversion to SI; times that are written as text."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import date
from math import pi
from typing import Literal

import numpy as np
import pyarrow as pa

from dynident.array_types import FloatArray
from dynident.recordings.arrow_tables import from_numbers, pc, to_floats
from dynident.recordings.recording import JointKind
from dynident.recordings.recording_metadata import RecordingError, Status

_DEGREE = pi / 180.0
_LENGTH = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "um": 1e-6}
_ANGLE = {"rad": 1.0, "mrad": 1e-3, "deg": _DEGREE, "degree": _DEGREE, "degrees": _DEGREE, "rev": 2.0 * pi}
_ANGLE |= {"gon": pi / 200.0, "mdeg": 1e-3 * _DEGREE, "arcmin": _DEGREE / 60.0, "arcsec": _DEGREE / 3600.0}
_KGF, _LBF, _INCH = 9.80665, 4.4482216152605, 0.0254
MOMENTS = {
    **{"N m": 1.0, "mN m": 1e-3, "kN m": 1e3, "N mm": 1e-3, "N cm": 1e-2, "cN m": 1e-2, "daN m": 10.0},
    **{"kgf m": _KGF, "kgf cm": 1e-2 * _KGF, "kg cm": 1e-2 * _KGF, "gf cm": 1e-5 * _KGF},
    **{"lbf ft": 12 * _INCH * _LBF, "lbf in": _INCH * _LBF, "ozf in": _INCH * _LBF / 16},
}
_FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": _KGF, "lbf": _LBF}

FACTORS: dict[tuple[str, JointKind | None], dict[str, float]] = {
    ("t", None): {
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "µs": 1e-6,
        "ns": 1e-9,
        "100ns": 1e-7,
        "min": 60.0,
        "h": 3600.0,
        "d": 86400.0,
    },
    ("q", "revolute"): _ANGLE,
    ("q", "prismatic"): _LENGTH,
    ("q_command", "revolute"): _ANGLE,
    ("q_command", "prismatic"): _LENGTH,
    ("dq", "revolute"): {f"{unit}/s": factor for unit, factor in _ANGLE.items()}
    | {"rpm": 2.0 * pi / 60.0, "rev/min": 2.0 * pi / 60.0},
    ("dq", "prismatic"): {f"{unit}/s": factor for unit, factor in _LENGTH.items()},
    ("ddq", "revolute"): {f"{unit}/s^2": factor for unit, factor in _ANGLE.items()},
    ("ddq", "prismatic"): {f"{unit}/s^2": factor for unit, factor in _LENGTH.items()},
    ("tau", "revolute"): MOMENTS,
    ("tau", "prismatic"): _FORCE,
    ("current", "revolute"): {"A": 1.0, "mA": 1e-3},
    ("current", "prismatic"): {"A": 1.0, "mA": 1e-3},
    ("base_force", None): _FORCE,
    ("base_moment", None): MOMENTS,
    ("temperature", "revolute"): {"degC": 1.0, "K": 1.0, "degF": 5.0 / 9.0},
    ("temperature", "prismatic"): {"degC": 1.0, "K": 1.0, "degF": 5.0 / 9.0},
}
"""Factor to SI by kind of signal and kind of joint; the first of each is the one taken where none is said."""

OFFSETS = {"K": -273.15, "degF": -32.0 * 5.0 / 9.0}
"""Added after the factor (temperatures only)."""

JOINT_KINDS = ("q", "q_command", "dq", "ddq", "tau", "current", "temperature")
"""Signals that every joint has."""

STORED_KINDS = tuple(kind for kind in JOINT_KINDS if kind != "current")
"""Those that a checked recording can hold: currents have become torques."""

_COUNTS = re.compile(r"counts:(\d+(?:\.\d*)?(?:e\d+)?)(?:@(-?\d+(?:\.\d*)?))?", re.IGNORECASE)
COUNTS = "counts:N (N counts per turn or per metre; counts:N@Z if zero is at Z counts)"
"""Positions as an encoder counts them, and how that is written."""

_SHARES = ("permille", "‰", "percent", "%")
"""Shares of a rated torque, which differs from joint to joint."""

KINDS = ("t", *JOINT_KINDS, "base_force", "base_moment")


def format_time(t: float) -> str:
    """Return a time in s as text: to the millisecond where it counts from 1970, of which six digits would be days."""
    return f"{t:.6g}" if abs(t) < _LONGEST_RUN else f"{t:.3f}"


_LONGEST_RUN = 1e5
"""s: a day and more."""


def find_our_unit(kind: str, joint: JointKind | None) -> str:
    """Return our unit of a kind of signal, one of `KINDS`, for a kind of joint: SI, and degC."""
    return next(iter(FACTORS[kind, joint]))


def find_conversion(kind: str, joint: JointKind | None, unit: str | None, where: str) -> tuple[float, float]:
    """Return factor and offset from a unit to ours.

    Parameters
    ----------
    kind : str
        Kind of signal, one of `KINDS`.
    joint : "revolute", "prismatic" or None
        Kind of joint; None for t and the base's wrench.
    unit : str or None
        As the user wrote it ("N*m", "Nm", "N·m" and "N m" are the same); None: SI.
    where : str
        The key of `units` that names it, for the error.

    Returns
    -------
    factor, offset : float
        ours = factor x theirs + offset.

    Raises
    ------
    RecordingError
        For a unit that is not known for this signal; names those that are.
    """
    factors = FACTORS[kind, joint]
    if unit is None:
        return 1.0, 0.0
    # Counts come before the table of units: how many of them make a turn is part of the unit.
    if kind in ("q", "q_command") and (counted := _COUNTS.fullmatch(unit.replace(" ", ""))) and float(counted[1]) > 0:
        factor = (2.0 * pi if joint == "revolute" else 1.0) / float(counted[1])
        return factor, -factor * float(counted[2] or 0.0)
    plain_unit = _normalise_unit(unit)
    for name, factor in factors.items():
        if _normalise_unit(name) == plain_unit:
            return factor, OFFSETS.get(name, 0.0)
    if kind == "tau" and plain_unit.casefold() in _SHARES:
        raise RecordingError(
            f"{unit} of a rated torque is not a unit of torque: name the columns as currents (current1, …), and give "
            f"drive gains in N m per {unit}.",
            pointer=f"/units/{where}",
            title="Unknown unit",
        )
    of = "" if joint is None else f" of a {joint} joint"
    counts = [COUNTS] if kind in ("q", "q_command") else []
    raise RecordingError(
        f"Unit {unit!r} is not known for {kind}{of}; choose from {', '.join([*factors, *counts])}.",
        pointer=f"/units/{where}",
        title="Unknown unit",
    )


def read_time_unit(name: str, stated: str | None) -> tuple[str, float]:
    """Return the unit of a time, as it is stated or the column's name ends, and the s of one; "" and 1 without."""
    known = FACTORS["t", None]
    ending = re.split("[^a-zµ0-9]+", name.casefold().rstrip(" )]"))[-1]
    unit = stated or (ending if ending in known else "")
    return unit, known.get(unit, 1.0)


def find_unit(units: Mapping[str, str], kind: str, columns: tuple[str, ...]) -> tuple[str | None, str]:
    """Return the unit of a column with the key that gave it: one of its names, else its kind of signal.

    Of commands of which nothing is said it is that of the positions.
    """
    # What is said of one column goes before what is said of its kind.
    for key in (*columns, kind):
        if key in units:
            return units[key], key
    if kind == "q_command":
        return find_unit(units, "q", tuple(name.replace(kind, "q", 1) for name in columns))
    return None, kind


def _normalise_unit(unit: str) -> str:
    """Return the unit without the differences in writing that do not matter."""
    unit = unit.replace("°C", "degC").replace("°", "deg")
    for sign in (" ", "*", "·", "⋅", ".", "_"):
        unit = unit.replace(sign, "")
    # The Greek mu and the micro sign look alike and are different characters.
    return unit.replace("²", "^2").replace("**2", "^2").replace("s2", "s^2").replace("μ", "µ")


def get_signal_of_unit(unit: str | None) -> Literal["t", "q", "dq", "ddq", "tau", "current"] | None:
    """Return the kind of signal that a unit belongs to, where it is only one."""
    if unit is None:
        return None
    if unit in FACTORS["q", "revolute"]:
        return "q"
    if unit in ("rad/s", "deg/s", "rpm", "mrad/s", "rev/s", "m/s", "mm/s", "cm/s"):
        return "dq"
    if unit in ("rad/s^2", "deg/s^2"):
        return "ddq"
    if unit in MOMENTS:
        return "tau"
    if unit in ("A", "mA"):
        return "current"
    if unit in FACTORS["t", None]:
        return "t"
    return None


def explain_velocity_ratio(velocity: str, position: str, ratio: float) -> tuple[Status, str, dict[str, str]] | None:
    """Explain a velocity that is not the derivative of its position, by the unit that either may have.

    Parameters
    ----------
    velocity, position : str
        What the user calls the columns.
    ratio : float
        The velocity over the derivative.

    Returns
    -------
    tuple or None
        The level, the sentence, and the unit to state by kind of signal; None where the ratio is right.
    """
    known_ratios = {
        1.0 / _DEGREE: ("one of them is in degrees, the other in radians", {"dq": "deg/s"}),
        _DEGREE: ("positions look like degrees, velocities like rad/s", {"q": "deg"}),
        30.0 / pi: ("the velocity looks like rpm", {"dq": "rpm"}),
    }
    claim = f"{velocity} is {abs(ratio):.4g} times the derivative of {position}"
    for factor, (meaning, units) in known_ratios.items():
        if abs(abs(ratio) / factor - 1.0) < 0.1:
            return "error", f"{claim}: {meaning}", units
    if ratio < 0.0:
        return "warning", f"{velocity} has the opposite sign of the derivative of {position}", {}
    if not _SLOWEST < ratio < _FASTEST:
        unused = "the velocity is not used, but one of the two columns has another unit, or is on the motor side"
        return "warning", f"{claim}; {unused}", {}
    return None


_SLOWEST, _FASTEST = 0.7, 1.4
"""Ratios of a velocity to the derivative of the position, within which filters and resolution may bring it."""
_SAME, _OFF, _DOUBLE, _DELAYED = 0.01, 0.05, 2.0, 0.1
"""Share by which the ratios of joints differ at most where a clock is wrong, by which it has to be, and a ratio beyond
which another unit of the velocities is as likely; and how much the correlation may miss of 1, as a share of what the
ratio misses: a wrong clock leaves it as it is, noise takes a little (`benchmarks/corrupted_samples.py --clocks`)."""


def find_common_ratio(ratios: Sequence[float], likeness: float) -> float:
    """Return by how much the velocities of all joints alike exceed the derivatives; 0 where they do not.

    A filter or a coarse resolution takes other shares of the velocity of each joint, unless all move at one frequency.
    It then delays the velocity, too: what a first-order filter leaves of the size is the correlation.

    Parameters
    ----------
    ratios : sequence of float
        Velocity over derivative, by joint.
    likeness : float
        The smallest correlation of a velocity with the derivative.
    """
    if len(ratios) < 2 or max(ratios) - min(ratios) > _SAME * max(ratios):
        return 0.0
    common = max(ratios)
    is_off = abs(common - 1.0) > _OFF and 1.0 / _DOUBLE < common < _DOUBLE
    return common if is_off and 1.0 - likeness < _DELAYED * abs(common - 1.0) else 0.0


SECONDS_OF_DAY = 86_400.0
_OF_ISO = (
    r"^\s*P(?:(?P<days>\d+)D)?T(?:(?P<hours>\d+)H)?(?:(?P<minutes>\d+)M)?(?:(?P<seconds>\d+(?:[.,]\d+)?)S)?"
    r"(?P<date>x)?(?P<zone>x)?(?P<half>x)?\s*$"
)
"""A duration of ISO 8601, PT1M0.5S; it has no date, zone or half of a day."""
_CLOCK = (
    r"^\s*(?:(?P<date>\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/. ](?:\d{1,2}|[A-Za-z]{3})[-/. ]\d{4}"
    r"|\d{1,2}[-/. ][A-Za-z]{3}[-/. ]\d{2})[T _,]+)?"
    r"(?:(?P<days>\d+) days?,? )?"
    r"(?P<hours>\d{1,2}):(?P<minutes>\d{2})(?::(?P<seconds>\d{1,2}(?:[.,:]\d+)?))?"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|UTC|GMT|[+-]\d{2}:?\d{2})?\s*$"
)
"""2025-05-06T10:20:30.005+02:00, 06.05.2025 10:20:30,005, 5/6/2025 1:20:30 PM, 10:20:30.005, 0 days 00:00:01.5."""
_COMPACT = (
    r"^\s*(\d{4})-?(\d{2})-?(\d{2})[T _-](\d{2})[-.:h]?(\d{2})[-.:m]?(\d{2})s?(?:[-.,:](\d+))?(Z|[+-]\d{2}:?\d{2})?\s*$"
)
"""20250506T102030.005, 20250506 10:20:30.005, 2025-05-06_10-20-30-005."""
_MINUTES = r"^\s*(?P<minutes>\d{1,3}):(?P<seconds>[0-5]\d(?:[.,]\d+)?)\s*$"
_TENTHS = r"^\s*\d{1,3}:[0-5]\d[.,]\d+\s*$"
"""12:05.250: a fraction stands behind seconds alone, so 12:05 beside it is no time of day; 1:02:05.250 may follow."""
_DURATION = r"^\s*(?P<value>[+-]?[\d.,]+(?:[eE][+-]?\d+)?)\s*(?P<unit>seconds|second|secs|sec|s|ms|us|ns|min)\s*$"
"""0.005 sec, as MATLAB writes the times of a timetable."""
_SECONDS = {"ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
_CENTURY = 2000
_MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")


def are_times(cells: Sequence[str]) -> bool:
    """Return whether all cells that are not empty are times."""
    filled = [cell for cell in cells if cell]
    forms: list[tuple[str, ...]] = [(_CLOCK,), (_DURATION,), (_COMPACT,), (_OF_ISO,)]
    if any(re.match(_TENTHS, cell) for cell in filled):
        forms = [(_MINUTES, _CLOCK)]
    return bool(filled) and any(
        all(any(re.match(form, cell) for form in together) for cell in filled) for together in forms
    )


def are_times_of_day(cells: Sequence[str]) -> bool:
    """Return whether all cells that are not empty are times of day, without a date."""
    clocks = [re.match(_CLOCK, cell) for cell in cells if cell]
    return bool(clocks) and all(clock is not None and not (clock["date"] or clock["days"]) for clock in clocks)


def parse_seconds(column: pa.Array) -> pa.Array:
    """Return written times as float64: seconds, from 1970 if there is a date; what is no time is missing."""
    if pc.any(pc.match_substring_regex(column, _TENTHS)).as_py():
        short = pc.extract_regex(column, _MINUTES)
        seconds = 60.0 * _parse_numbers(short, "minutes", np.nan) + _parse_numbers(short, "seconds", np.nan)
        # From the first hour on there are three parts.
        longer = parse_seconds(pc.if_else(pc.is_valid(short), pa.scalar(None, column.type), column))
        return from_numbers(np.where(np.isnan(seconds), to_floats(longer), seconds))
    clock = pc.extract_regex(pc.replace_substring_regex(column, _COMPACT, r"\1-\2-\3 \4:\5:\6.\70\8"), _CLOCK)
    # No cell is a time of day: they may be durations with a unit.
    if clock.null_count == len(clock):
        if not pc.any(pc.match_substring_regex(column, _OF_ISO)).as_py():
            return _parse_durations(pc.extract_regex(column, _DURATION))
        clock = pc.extract_regex(column, _OF_ISO)
    hours, minutes, days = (_parse_numbers(clock, name) for name in ("hours", "minutes", "days"))
    total = 3600.0 * hours + 60.0 * minutes + _parse_numbers(clock, "seconds") + SECONDS_OF_DAY * days
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
        year = int(parts[2]) + (_CENTURY if len(parts[2]) == 2 else 0)
        first, second = int(parts[0]), parts[1].casefold()
        if second in _MONTHS:
            day, month = first, _MONTHS.index(second) + 1
        # Slashes mean the American order, month first, unless that is impossible.
        elif "/" in text and first <= 12:
            month, day = first, int(second)
        else:
            day, month = first, int(second)
    try:
        return (date(year, month, day) - date(1970, 1, 1)).days * SECONDS_OF_DAY
    except ValueError:
        # Such as the 31st of June: the cell is no date.
        return np.nan


def _convert_zone(text: str) -> float:
    if text[0] not in "+-":
        return 0.0
    minutes = 60 * int(text[1:3]) + int(text[-2:])
    return 60.0 * (minutes if text[0] == "+" else -minutes)
