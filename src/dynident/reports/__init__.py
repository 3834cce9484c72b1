"""Figures and documents."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dynident.reports.run import ReportedRun
from dynident.reports.validated import ReportedTable, ReportedValidation

if TYPE_CHECKING:
    from dynident.reports.report import html_report

__all__ = ["ReportedRun", "ReportedTable", "ReportedValidation", "html_report"]


def __getattr__(name: str) -> Any:
    # Matplotlib takes longer to load than most commands to run: only who draws waits for it.
    if name == "html_report":
        from dynident.reports.report import html_report

        return html_report
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
