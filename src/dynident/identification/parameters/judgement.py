"""What an interval says of a parameter."""

from __future__ import annotations

from typing import Literal

from dynident.identification.thresholds import DETERMINED

ParameterJudgement = Literal["determined", "uncertain", "zero_in_interval"]


def judged(value: float, deviation: float, half_width: float, owed: bool) -> ParameterJudgement:
    """Judge an estimate by its standard deviation and its 95 % interval.

    `owed`: it is known for what was known beside the data rather than for the data.
    """
    if abs(value) <= half_width:
        return "zero_in_interval"
    return "determined" if deviation <= DETERMINED * abs(value) and not owed else "uncertain"
