"""Types of tables with marks and exact values, from which terminal, report, HTTP and page print."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isfinite
from typing import Literal

from dynident.number_format import format_number, format_percent

Mark = Literal["ok", "warning", "error", "plain"]


@dataclass(frozen=True)
class Cell:
    """One cell of a table.

    Parameters
    ----------
    text : str
        What the reader sees.
    value : float, optional
        The exact number, where the text is of one number.
    mark : "ok", "warning", "error", "plain" or None
        How good the news is.
    note : str
        More about the cell, for those who ask.
    is_figures : bool
        True where the text holds several numbers.
    """

    text: str
    value: float | None = None
    mark: Mark | None = None
    note: str = ""
    is_figures: bool = False


@dataclass(frozen=True)
class ReportedTable:
    """A table of text.

    Parameters
    ----------
    title : str
        Heading of the table.
    columns : tuple of str
        Heads of the columns.
    rows : tuple of tuple of Cell
        Rows, each as long as `columns`.
    numbers_from : int
        Columns from this index on hold numbers.
    groups : tuple of str
        The heading above each row, where the rows stand under headings; else empty.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    numbers_from: int = 1
    groups: tuple[str, ...] = ()

    def drop_columns(self, *columns: str) -> ReportedTable:
        """Return the table without some of its columns.

        Parameters
        ----------
        columns : str
            Heads of columns, each to the right of `numbers_from`, which is not changed.

        Returns
        -------
        ReportedTable
            The table with the remaining columns, in their order.
        """
        # Columns are told by their heads: a table may grow without its users counting anew.
        remaining = [k for k, column in enumerate(self.columns) if column not in columns]
        rows = tuple(tuple(row[k] for k in remaining) for row in self.rows)
        return replace(self, columns=tuple(self.columns[k] for k in remaining), rows=rows)

    def is_figures(self, column: int) -> bool:
        """Return whether a column holds numbers, or intervals of them."""
        return any(row[column].value is not None or row[column].is_figures for row in self.rows)

    @property
    def texts(self) -> list[list[str]]:
        """The rows as plain texts."""
        return [[cell.text for cell in row] for row in self.rows]


def make_text_cells(*texts: str) -> list[Cell]:
    """Return a cell for each text."""
    return [Cell(text) for text in texts]


def make_number_cell(value: float | None, digits: int = 3, unit: str = "") -> Cell:
    """Return a cell for a number with its unit; "–" for None.

    Parameters
    ----------
    value : float or None
        The number.
    digits : int
        Significant digits.
    unit : str
        Unit behind the number; "" for none.

    Returns
    -------
    Cell
        The cell, which keeps the exact number, too.
    """
    text = format_number(value, digits)
    return Cell(f"{text} {unit}" if unit and value is not None else text, value)


def make_percent_cell(value: float | None, digits: int = 3) -> Cell:
    """Return a cell for a fraction, in per cent.

    Parameters
    ----------
    value : float or None
        The fraction.
    digits : int
        Significant digits.

    Returns
    -------
    Cell
        The cell, which keeps the exact fraction, too.
    """
    return Cell(format_percent(value, digits), value)


def make_percent_cells(values: Iterable[float | None]) -> list[Cell]:
    """Return a cell for each fraction, in per cent."""
    return [make_percent_cell(value) for value in values]


def make_interval_cell(ends: tuple[float | None, float | None] | None, absent: str = "–") -> Cell:
    """Return a cell for the ends of an interval.

    Parameters
    ----------
    ends : (float, float) or None
        None, or an end that is None or infinite, is no interval.
    absent : str
        Text where there is no interval.

    Returns
    -------
    Cell
        The cell, with its ends as text.
    """
    if ends is None or any(end is None or not isfinite(end) for end in ends):
        return Cell(absent)
    return Cell(" to ".join(format_number(end) for end in ends), is_figures=True)
