"""How figures are written for people: enough digits, always with a unit."""

from __future__ import annotations

from math import floor, isfinite, log10

NARROW_SPACE = "\u202f"
MINUS = "\u2212"


def number(value: float | None, digits: int = 3) -> str:
    """A number with so many significant digits; "–" where there is none, "∞" where it is infinite."""
    if value is None or value != value:
        return "–"
    if not isfinite(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if value == 0:
        return "0"
    if not 1e-4 <= abs(value) < 1e6:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return _minus(f"{mantissa}·10") + _superscript(int(exponent))
    return _minus(f"{value:.{_decimals(value, digits)}f}")


def estimate(value: float, deviation: float) -> tuple[str, str]:
    """A value and its standard deviation with the same number of decimals, two significant digits in the latter."""
    if not (isfinite(deviation) and deviation > 0 and 1e-4 <= deviation < 1e5 and abs(value) < 1e6):
        return number(value, 4), number(deviation, 2)
    decimals = _decimals(deviation, 2)
    return _minus(f"{value:.{decimals}f}"), f"{deviation:.{decimals}f}"


def percent(fraction: float | None, digits: int = 3) -> str:
    """A fraction as per cent; anything beyond 1000 % only as that."""
    if fraction is None or fraction != fraction:
        return "–"
    if fraction > 10:
        return f"> 1000{NARROW_SPACE}%"
    if fraction == 0:
        return f"0{NARROW_SPACE}%"
    scaled = 100 * fraction
    return _minus(f"{scaled:.{min(3, _decimals(scaled, digits))}f}") + f"{NARROW_SPACE}%"


def p_value(p: float) -> str:
    """A p-value; what is below one in a million is only said to be so."""
    return f"< 10{_superscript(-6)}" if p < 1e-6 else number(p, 2)


def span(low: float, high: float, unit: str, digits: int = 3) -> str:
    """A range with its unit."""
    return f"{number(low, digits)} … {number(high, digits)} {unit}"


def counted(count: int, noun: str, plural: str | None = None) -> str:
    """A count with its noun in the right number."""
    return f"{count:,} {noun if count == 1 else plural or noun + 's'}".replace(",", NARROW_SPACE)


def _decimals(value: float, digits: int) -> int:
    return max(0, digits - 1 - floor(log10(abs(value))))


def _minus(text: str) -> str:
    return text.replace("-", MINUS)


def _superscript(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))
