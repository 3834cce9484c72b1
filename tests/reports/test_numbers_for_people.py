"""Figures as people read them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.number_format import format_count, format_estimate, format_number, format_p_value, format_percent


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (1234.5, "1234"),
        (12.345, "12.3"),
        (-0.012345, "−0.0123"),
        (1.5e-7, "1.50·10⁻⁷"),
        (2e9, "2.00·10⁹"),
        (math.nan, "–"),
        (math.inf, "∞"),
        (None, "–"),
    ],
)
def test_three_significant_digits_and_words_for_what_is_no_number(value: float | None, text: str) -> None:
    assert format_number(value) == text


def test_a_value_is_given_to_the_second_digit_of_its_standard_deviation() -> None:
    assert format_estimate(12.34567, 0.0312) == ("12.346", "0.031")
    assert format_estimate(1234.567, 31.2) == ("1235", "31")
    assert format_estimate(0.5, 0.0) == ("0.5000", "0")


def test_per_cents_beyond_all_reason_are_not_written_out() -> None:
    assert format_percent(0.05432) == "5.43\u202f%"
    assert format_percent(12345.0) == "> 1000\u202f%"
    assert format_percent(math.inf) == "> 1000\u202f%"
    assert format_percent(-0.01) == "−1.00\u202f%"
    assert [format_percent(share) for share in (0.0, 4e-6, -4e-6, 6e-6)] == [*3 * ["0\u202f%"], "0.001\u202f%"]


def test_limits_in_sentences_have_the_decimals_that_are_asked_for() -> None:
    assert format_percent(0.15, decimals=0) == "15\u202f%"
    assert format_percent(0.0358, decimals=2) == "3.58\u202f%"


@pytest.mark.parametrize("folder", ["src", "service"])
def test_no_other_code_writes_percentages(folder: str) -> None:
    """Python's own format has no space before the sign."""
    modules = (Path(__file__).resolve().parents[2] / folder).rglob("*.py")
    assert not [path for path in modules if re.search(r":[+,\d]*\.\d%\}", path.read_text(encoding="utf-8"))]


def test_counts_and_their_nouns_agree() -> None:
    assert format_count(1, "row") == "1 row"
    assert format_count(12345, "sample") == "12\u202f345 samples"


def test_a_tiny_p_is_only_said_to_be_tiny() -> None:
    assert format_p_value(1e-9) == "< 10⁻⁶"
    assert format_p_value(0.04) == "0.040"


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12))
def test_what_is_written_is_the_number_to_its_last_digit(value: float) -> None:
    text = format_number(value, 4).replace("−", "-")
    mantissa, sign, exponent = text.partition("·10")
    power = int(exponent.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))) if sign else 0
    assert float(mantissa) * 10.0**power == pytest.approx(value, rel=6e-4)
