"""What a report is told about one validation."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.reports.tables import ReportedTable
from dynident.validation import Judged


@dataclass(frozen=True)
class ReportedValidation:
    """One validation: what was tried, how it ended and why, the figures behind it, and its kind where that is known."""

    title: str
    judged: Judged
    tables: tuple[ReportedTable, ...] = ()
    kind: str = ""
