"""Format numbers, estimates with uncertainty, percentages and p-values as text for people."""

from __future__ import annotations

from math import floor, isfinite, log10

NARROW_SPACE = "\u202f"
MINUS = "\u2212"
# Of a percentage: less than that of a torque no sensor shows.
_MOST_DECIMALS = 3


def format_number(value: float | None, digits: int = 3) -> str:
    """Format a number with some significant digits.

    Parameters
    ----------
    value : float or None
        The number.
    digits : int
        Significant digits.

    Returns
    -------
    str
        "–" for None and NaN, "∞" for infinity; powers of ten for very small and very large numbers.
    """
    # Only NaN differs from itself.
    if value is None or value != value:
        return "–"
    if not isfinite(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if value == 0:
        return "0"
    # Outside this range decimals, or digits before the point, would be counted by the reader instead of read.
    if not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return _set_minus_sign(f"{mantissa}·10") + _to_superscript(int(exponent))
    return _set_minus_sign(f"{value:.{_count_decimals(value, digits)}f}")


def format_estimate(value: float, deviation: float) -> tuple[str, str]:
    """Format a value and its standard deviation with the same number of decimals.

    Parameters
    ----------
    value : float
        The estimate.
    deviation : float
        Standard deviation, in the unit of `value`.

    Returns
    -------
    value, deviation : str
        The deviation has two significant digits.
    """
    # Where the deviation says nothing about the decimals, each number gets its own significant digits.
    if not (isfinite(deviation) and deviation > 0 and 1e-4 <= deviation < 1e5 and abs(value) < 1e6):
        return format_number(value, 4), format_number(deviation, 2)
    decimals = _count_decimals(deviation, 2)
    return _set_minus_sign(f"{value:.{decimals}f}"), f"{deviation:.{decimals}f}"


def format_percent(fraction: float | None, digits: int = 3, *, decimals: int | None = None) -> str:
    """Format a fraction in per cent.

    Parameters
    ----------
    fraction : float or None
        The fraction, 1 for 100 %.
    digits : int
        Significant digits; never more than three decimals.
    decimals : int, optional
        Number of decimals, in place of `digits`. Sentences state limits and rough shares without decimals.

    Returns
    -------
    str
        "–" for None and NaN, "> 1000 %" for more than that.
    """
    if fraction is None or fraction != fraction:
        return "–"
    # A residual ten times as large as the torque itself: how many times does not matter any more.
    if fraction > 10:
        return f"> 1000{NARROW_SPACE}%"
    scaled = 100 * fraction
    # Zeros behind the point would claim a precision, and a sign before them a direction.
    if decimals is None and abs(scaled) < 0.5 * 10.0**-_MOST_DECIMALS:
        return f"0{NARROW_SPACE}%"
    places = min(_MOST_DECIMALS, _count_decimals(scaled, digits)) if decimals is None else decimals
    return _set_minus_sign(f"{scaled:.{places}f}") + f"{NARROW_SPACE}%"


def format_p_value(p: float) -> str:
    """Format a p-value; below one in a million only as "< 10⁻⁶".

    Such small values rest on tails of distributions that no data confirm.

    Parameters
    ----------
    p : float
        The p-value, from 0 to 1.

    Returns
    -------
    str
        The p-value with two significant digits.
    """
    return f"< 10{_to_superscript(-6)}" if p < 1e-6 else format_number(p, 2)


def format_range(low: float, high: float, unit: str, digits: int = 3) -> str:
    """Format a range with its unit.

    Parameters
    ----------
    low, high : float
        Ends of the range.
    unit : str
        Unit of both ends.
    digits : int
        Significant digits of each end.

    Returns
    -------
    str
        Both ends with one unit behind them.
    """
    return f"{format_number(low, digits)} … {format_number(high, digits)} {unit}"


_LONGEST_IN_SECONDS = 120.0


def choose_time_unit(longest: float) -> tuple[str, float]:
    """Return the unit in which times up to a longest one (s) are shown, and its length in s."""
    return ("s", 1.0) if longest < _LONGEST_IN_SECONDS else ("min", 60.0)


def format_count(count: int, noun: str) -> str:
    """Format a count with its noun in the singular or the plural.

    Parameters
    ----------
    count : int
        The count.
    noun : str
        The noun in the singular.

    Returns
    -------
    str
        The count and the noun, with narrow spaces between thousands.
    """
    return f"{count:,} {noun if count == 1 else noun + 's'}".replace(",", NARROW_SPACE)


def _count_decimals(value: float, digits: int) -> int:
    """Return how many decimals show a value with so many significant digits."""
    return max(0, digits - 1 - floor(log10(abs(value))))


def _set_minus_sign(text: str) -> str:
    return text.replace("-", MINUS)


def _to_superscript(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
