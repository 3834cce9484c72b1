"""What an interval says of a parameter."""

from __future__ import annotations

from typing import Literal

ParameterJudgement = Literal["determined", "uncertain", "zero_in_interval"]

DETERMINED = 0.1
"""Relative standard deviation of a determined parameter, at most: its first digit is sure, its 95 % interval within
about a fifth of the value."""


def judged(value: float, deviation: float, half_width: float, owed: bool) -> ParameterJudgement:
    """Judge an estimate by its standard deviation and its 95 % interval.

    `owed`: it is known for what was known beside the data rather than for the data.
    """
    if abs(value) <= half_width:
        return "zero_in_interval"
    return "determined" if deviation <= DETERMINED * abs(value) and not owed else "uncertain"
