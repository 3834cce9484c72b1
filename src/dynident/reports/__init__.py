"""Figures and documents."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.lazy import lazily

if TYPE_CHECKING:
    from dynident.reports.printing.pdf import pdf_of
    from dynident.reports.report import html_report
    from dynident.reports.run import ReportedRun
    from dynident.reports.stated import ReportChoices
    from dynident.reports.tables import Cell, ReportedTable
    from dynident.reports.validated import ReportedValidation

__all__ = ["Cell", "ReportChoices", "ReportedRun", "ReportedTable", "ReportedValidation", "html_report", "pdf_of"]

if not TYPE_CHECKING:
    # Matplotlib takes longer to load than most commands to run: only who draws waits for it. Who writes numbers in
    # words waits for nothing.
    __getattr__ = lazily(__name__)
