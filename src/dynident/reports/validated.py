"""What a report is told about one validation."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.validation import Judged


@dataclass(frozen=True)
class ReportedTable:
    """Figures behind a verdict, in words: a title, column heads, rows as wide as these; numbers from one column on."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    numbers_from: int = 1


@dataclass(frozen=True)
class ReportedValidation:
    """One validation: what was tried, how it ended and why, and the figures behind it."""

    title: str
    judged: Judged
    tables: tuple[ReportedTable, ...] = ()
