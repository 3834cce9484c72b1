"""Reports of identified models: tables, figures, and documents in HTML and PDF."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy_loader import make_lazy_exports

if TYPE_CHECKING:
    from dynident.presentation.tables import Cell, ReportedTable
    from dynident.reports.html_page import html_report
    from dynident.reports.pdf_report import render_pdf
    from dynident.reports.reported_data import ReportChoices, ReportedRecording, ReportedValidation

__all__ = [
    "Cell",
    "ReportChoices",
    "ReportedRecording",
    "ReportedTable",
    "ReportedValidation",
    "html_report",
    "render_pdf",
]

if not TYPE_CHECKING:
    # Loading matplotlib takes longer than most commands take to run, so it is imported only when something is drawn.
    __getattr__, __dir__ = make_lazy_exports(__name__)
