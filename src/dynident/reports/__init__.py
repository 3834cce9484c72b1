"""Figures and documents."""

from dynident.reports.report import html_report
from dynident.reports.run import ReportedRun

__all__ = ["ReportedRun", "html_report"]
