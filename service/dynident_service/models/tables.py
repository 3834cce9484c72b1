"""Figures as tables for people on the wire."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from dynident_service.models.common import ViewModel


class TableColumn(ViewModel):
    """A column of a table."""

    word: str
    figures: bool = Field(description="Whether it holds figures")


class TableCell(ViewModel):
    """What stands in one place of a table."""

    text: str
    value: float | None = Field(description="Of a figure, exactly")
    mark: Literal["ok", "warning", "error", "plain"] | None = Field(description="How good the news is")
    note: str = Field(description="What more there is to say to who asks")


class Table(ViewModel):
    """A table in words: the same on the command line and in reports."""

    title: str
    columns: list[TableColumn]
    rows: list[list[TableCell]]
    groups: list[str] = Field(description="The heading that each row stands under; [] where there are none")


class Tables(ViewModel):
    """Several tables."""

    items: list[Table]


class WithTables(ViewModel):
    """What may be shown as tables."""

    tables: list[Table] = Field(
        default=[],
        description="The figures of the result as tables for people, as on the command line and in reports; only where "
        "it is asked for by itself, not in lists",
    )
