"""Tables in words: the same on the command line, in reports, over HTTP and on the page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import isfinite
from typing import Literal

from dynident.reports.numbers import number, percent

Mark = Literal["ok", "warning", "error", "plain"]


@dataclass(frozen=True)
class Cell:
    """What stands in one place: words, the exact value where they are of a figure, and how good the news is.

    `note` is what more there is to say to who asks.
    """

    text: str
    value: float | None = None
    mark: Mark | None = None
    note: str = ""


@dataclass(frozen=True)
class ReportedTable:
    """A title, column heads, rows as wide as these; figures from the column `numbers_from` on.

    `groups` has the heading that each row stands under, where rows stand under headings of their own.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    numbers_from: int = 1
    groups: tuple[str, ...] = ()

    @property
    def texts(self) -> list[list[str]]:
        """The rows in words alone."""
        return [[cell.text for cell in row] for row in self.rows]


def words(*texts: str) -> list[Cell]:
    """Cells of words."""
    return [Cell(text) for text in texts]


def figure(value: float | None, digits: int = 3, unit: str = "") -> Cell:
    """A number with its unit."""
    text = number(value, digits)
    return Cell(f"{text} {unit}" if unit and value is not None else text, value)


def share(value: float | None, digits: int = 3) -> Cell:
    """A share as per cent."""
    return Cell(percent(value, digits), value)


def shares(values: Iterable[float | None]) -> list[Cell]:
    """Several of them."""
    return [share(value) for value in values]


def interval(ends: tuple[float | None, float | None] | None, absent: str = "–") -> Cell:
    """Both ends of an interval; `absent` where there is none."""
    if ends is None or any(end is None or not isfinite(end) for end in ends):
        return Cell(absent)
    return Cell(" to ".join(number(end) for end in ends))
