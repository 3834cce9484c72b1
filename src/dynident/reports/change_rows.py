"""What differs, in words: the same on the command line, in a notebook and in a report."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from dynident.diagnosis import Change, FrictionDifference
from dynident.reports.numbers import number, p_value, percent
from dynident.reports.words import place_text, title_of
from dynident.robot import Robot

COLUMNS = ("changed", "joint", "parameter", "before", "difference", "95 % interval", "unit", "p")

FRICTION_COLUMNS = ("friction of", "at a speed of", "before", "difference", "95 % interval", "unit", "of what it was")


class ChangeCells(NamedTuple):
    """A number that differs, in words: what `COLUMNS` says."""

    title: str
    place: str
    parameter: str
    before: str
    difference: str
    interval: str
    unit: str
    p: str


def change_rows(one: Change, robot: Robot) -> Iterator[ChangeCells]:
    """A row of `COLUMNS` for each number of a change, the one that says how large it is first; it alone has p."""
    for value in (one.main, *one.more):
        yield ChangeCells(
            title_of(one.choice.effect),
            place_text(one.choice.joints, robot.joint_names),
            value.parameter,
            "–" if value.before is None else number(value.before),
            _signed(value.value),
            " to ".join(number(end) for end in value.interval),
            "" if value.unit == "-" else value.unit,
            p_value(one.p_value) if value is one.main else "",
        )


class FrictionCells(NamedTuple):
    """By how much the friction of a joint differs, in words: what `FRICTION_COLUMNS` says."""

    joint: str
    speed: str
    before: str
    difference: str
    interval: str
    unit: str
    share: str


def friction_row(one: FrictionDifference) -> FrictionCells:
    """A row of `FRICTION_COLUMNS`: of each joint, whether that is a finding or not."""
    return FrictionCells(
        one.joint,
        f"{number(one.speed)} {'m/s' if one.unit == 'N' else 'rad/s'}",
        number(one.before),
        _signed(one.value),
        " to ".join(number(end) for end in one.interval),
        one.unit,
        f"{'+' if one.value > 0 else ''}{percent(one.value / one.before, 2)}" if one.before > 0.0 else "–",
    )


def _signed(value: float) -> str:
    return f"{'+' if value > 0 else ''}{number(value)}"
