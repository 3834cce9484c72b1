"""Figures and documents."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynident.reports.printing.pdf import pdf_of
    from dynident.reports.report import html_report
    from dynident.reports.run import ReportedRun
    from dynident.reports.validated import ReportedTable, ReportedValidation

__all__ = ["ReportedRun", "ReportedTable", "ReportedValidation", "html_report", "pdf_of"]


_HOMES = {
    "ReportedRun": "dynident.reports.run",
    "ReportedTable": "dynident.reports.validated",
    "ReportedValidation": "dynident.reports.validated",
    "html_report": "dynident.reports.report",
    "pdf_of": "dynident.reports.printing.pdf",
}


def __getattr__(name: str) -> Any:
    # Matplotlib takes longer to load than most commands to run: only who draws waits for it. Who writes numbers in
    # words waits for nothing.
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
