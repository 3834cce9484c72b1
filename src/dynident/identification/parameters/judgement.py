"""Judge an estimated parameter by its interval."""

from __future__ import annotations

from typing import Literal

from dynident.identification.thresholds import DETERMINED

ParameterJudgement = Literal["determined", "uncertain", "zero_in_interval"]


def judge_parameter(value: float, deviation: float, half_width: float, owed: bool) -> ParameterJudgement:
    """Judge an estimate by its standard deviation and its 95 % interval.

    Parameters
    ----------
    value, deviation, half_width : float
        Estimate, standard deviation, and half of the interval's width, in one unit.
    owed : bool
        Whether prior knowledge rather than the data determines it.

    Returns
    -------
    str
        "determined", "uncertain" or "zero_in_interval".
    """
    # Zero in the interval comes first: such a parameter is small, which is no fault of the motion.
    if abs(value) <= half_width:
        return "zero_in_interval"
    return "determined" if deviation <= DETERMINED * abs(value) and not owed else "uncertain"
