"""Types of tables with marks and exact values, from which terminal, report, HTTP and page print."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from textwrap import wrap
from typing import Literal

from dynident.number_format import format_number, format_percent
from dynident.text_and_html_tables import format_text_table, render_table

# Characters of a line of a head: numbers with their units have about as many.
_HEAD_WIDTH = 14

# Characters of a cell from which on it holds sentences, which no column of a narrow page has room for.
_SENTENCE = 60

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
        True where the text holds several numbers, or stands in a column of numbers for one that is missing.
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
    notes : tuple of str
        Sentences below the table, which explain its columns or say what follows from it.
    name : str
        What programs know the table by, "" where it is the only one.
    marked_rows : tuple of int
        Indices of rows that stand out, such as findings.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    numbers_from: int = 1
    groups: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    name: str = ""
    marked_rows: tuple[int, ...] = ()

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

    def fold_rows(self, column: str, most: int, last: int = 0) -> ReportedTable:
        """Return the table with the rows whose numbers in a column are the largest, and one row for all others.

        Parameters
        ----------
        column : str
            Head of the column.
        most : int
            Rows that are kept, in their order, whatever the signs of the numbers; a warning instead of a number, such
            as "diverged", comes before all others, and "–" after them.
        last : int
            Rows at the end that are kept as they are, such as sums.

        Returns
        -------
        ReportedTable
            The table itself where it has few rows.
        """
        own, index = self.rows[: len(self.rows) - last], self.columns.index(column)
        if len(own) <= most + 1:
            return self
        cells = [row[index] for row in own]
        without = [-math.inf if cell.mark == "warning" else math.inf for cell in cells]
        order = sorted(range(len(own)), key=lambda k: without[k] if (value := cells[k].value) is None else -abs(value))
        # "at most –" would say nothing.
        largest = cells[order[most]]
        bound = Cell("–" if largest.value is None else f"at most {largest.text.lstrip('+−')}", is_figures=True)
        rest = [Cell(f"{len(own) - most} others"), *(Cell("") for _ in self.columns[1:])]
        rest[index] = bound
        rows = (*(own[k] for k in sorted(order[:most])), tuple(rest), *self.rows[len(own) :])
        return replace(self, rows=rows, groups=(), marked_rows=())

    def is_figures(self, column: int) -> bool:
        """Return whether a column holds numbers, or intervals of them."""
        return any(row[column].value is not None or row[column].is_figures for row in self.rows)

    @property
    def is_wordy(self) -> bool:
        """Whether a cell holds sentences: on a narrow page such rows stand below each other, not in columns."""
        return any(len(text) > _SENTENCE for row in self.texts for text in row)

    @property
    def texts(self) -> list[list[str]]:
        """The rows as plain texts."""
        return [[cell.text for cell in row] for row in self.rows]

    @property
    def heads(self) -> list[str]:
        """The heads of the columns, in short lines: numbers below them are narrow."""
        # At commas first: what stands behind one belongs together.
        parts = (column.replace(", ", ",\n").split("\n") for column in self.columns)
        return [
            "\n".join("\n".join(wrap(part, _HEAD_WIDTH, break_long_words=False)) for part in head) for head in parts
        ]

    def to_text(self, title: str, *, most: int | None = None) -> str:
        """Return the table, or its first rows, as plain text under another title.

        Parameters
        ----------
        title : str
            The line above the table.
        most : int, optional
            Rows that are shown at most; all by default.

        Returns
        -------
        str
            Lines for a console.
        """
        return format_text_table(title, self.heads, self.texts[:most], len(self.rows), right_from=self.numbers_from)

    def to_html(self) -> str:
        """Return the table as an HTML element for notebooks, without its title."""
        return render_table(self.columns, self.texts, right_from=self.numbers_from)


def make_text_cells(*texts: str) -> list[Cell]:
    """Return a cell for each text."""
    return [Cell(text) for text in texts]


def make_number_cell(value: float | None, digits: int = 3, unit: str = "") -> Cell:
    """Return a cell for a number with its unit; "–" for None."""
    text = format_number(value, digits)
    return Cell(f"{text} {unit}" if unit and value is not None else text, value, is_figures=value is None)


def make_percent_cell(value: float | None, digits: int = 3) -> Cell:
    """Return a cell for a fraction, in per cent."""
    return Cell(format_percent(value, digits), value, is_figures=value is None)


def make_percent_cells(values: Iterable[float | None]) -> list[Cell]:
    """Return a cell for each fraction, in per cent."""
    return [make_percent_cell(value) for value in values]


def make_interval_cell(ends: tuple[float | None, float | None] | None, absent: str = "–") -> Cell:
    """Return a cell for the ends of an interval."""
    if ends is None or any(end is None or not math.isfinite(end) for end in ends):
        return Cell(absent)
    return Cell(" to ".join(format_number(end) for end in ends), is_figures=True)
