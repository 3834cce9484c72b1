"""Tables in words: the same on the command line, in reports, over HTTP and on the page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isfinite
from typing import Literal

from dynident.reports.numbers import number, percent

Mark = Literal["ok", "warning", "error", "plain"]


@dataclass(frozen=True)
class Cell:
    """What stands in one place: words, the exact value where they are of one figure, and how good the news is.

    `note` is what more there is to say, `is_figures` says of words that they are of several figures.
    """

    text: str
    value: float | None = None
    mark: Mark | None = None
    note: str = ""
    is_figures: bool = False


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

    def without(self, *columns: str) -> ReportedTable:
        """The same without some of its columns, each of them behind the first figures."""
        kept = [k for k, column in enumerate(self.columns) if column not in columns]
        rows = tuple(tuple(row[k] for k in kept) for row in self.rows)
        return replace(self, columns=tuple(self.columns[k] for k in kept), rows=rows)

    def is_figures(self, column: int) -> bool:
        """Whether a column holds figures, or intervals of them."""
        return any(row[column].value is not None or row[column].is_figures for row in self.rows)

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
    return Cell(" to ".join(number(end) for end in ends), is_figures=True)
