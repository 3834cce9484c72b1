"""Candidates and changes as rows of text, for the command line, notebooks and reports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import NamedTuple

from dynident.diagnosis import Change, FrictionDifference, RankedEffect
from dynident.reports.labels import format_joints, get_effect_title
from dynident.reports.number_format import format_number, format_p_value, format_percent
from dynident.robot import Robot

CANDIDATE_COLUMNS = ("rank", "effect", "joints", "error before", "after", "drop", "significant")


def format_candidates(ranked: Iterable[RankedEffect], robot: Robot) -> list[tuple[str, ...]]:
    """Return ranked candidates as rows of text.

    Parameters
    ----------
    ranked : iterable of RankedEffect
        Best first.
    robot : Robot
        The diagnosed robot.

    Returns
    -------
    list of tuples of str
        Rows with the cells of `CANDIDATE_COLUMNS`.
    """
    return [
        (
            str(candidate.rank),
            get_effect_title(candidate.effect),
            format_joints(candidate.joints, robot.joint_names),
            format_percent(candidate.error_before),
            format_percent(candidate.error_after),
            format_percent(candidate.error_drop, 2),
            "yes" if candidate.significant else "no",
        )
        for candidate in ranked
    ]


CHANGE_COLUMNS = ("changed", "joint", "parameter", "before", "difference", "95 % interval", "unit", "p")

FRICTION_COLUMNS = ("friction of", "at a speed of", "before", "difference", "95 % interval", "unit", "of what it was")


class ChangeCells(NamedTuple):
    """One number that differs, as the cells of `CHANGE_COLUMNS`."""

    title: str
    place: str
    parameter: str
    before: str
    difference: str
    interval: str
    unit: str
    p: str


def format_change(change: Change, robot: Robot) -> Iterator[ChangeCells]:
    """Yield the numbers of a change as rows of text, the main one first; only the main one has a p-value.

    Parameters
    ----------
    change : Change
        The change, with all its parameters.
    robot : Robot
        The robot that has changed.

    Yields
    ------
    ChangeCells
        The cells of one parameter.
    """
    for value in (change.main, *change.more):
        yield ChangeCells(
            get_effect_title(change.choice.effect),
            format_joints(change.choice.joints, robot.joint_names),
            value.parameter,
            "–" if value.before is None else format_number(value.before),
            _format_signed(value.value),
            " to ".join(format_number(end) for end in value.interval),
            "" if value.unit == "-" else value.unit,
            # The test is one of the whole change, not of each of its parameters.
            format_p_value(change.p_value) if value is change.main else "",
        )


class FrictionCells(NamedTuple):
    """The difference of one joint's friction, as the cells of `FRICTION_COLUMNS`."""

    joint: str
    speed: str
    before: str
    difference: str
    interval: str
    unit: str
    share: str


def format_friction_difference(difference: FrictionDifference) -> FrictionCells:
    """Return the difference of one joint's friction as a row of text.

    Parameters
    ----------
    difference : FrictionDifference
        The difference of any joint that moves, significant or not.

    Returns
    -------
    FrictionCells
        The cells of the row.
    """
    return FrictionCells(
        difference.joint,
        f"{format_number(difference.speed)} {'m/s' if difference.unit == 'N' else 'rad/s'}",
        format_number(difference.before),
        _format_signed(difference.value),
        " to ".join(format_number(end) for end in difference.interval),
        difference.unit,
        f"{'+' if difference.value > 0 else ''}{format_percent(difference.value / difference.before, 2)}"
        if difference.before > 0.0
        else "–",
    )


def _format_signed(value: float) -> str:
    return f"{'+' if value > 0 else ''}{format_number(value)}"
