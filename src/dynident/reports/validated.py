"""One validation as a report shows it."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.reports.tables import ReportedTable
from dynident.validation import ValidationOutcome


@dataclass(frozen=True)
class ReportedValidation:
    """The result of one validation.

    Attributes
    ----------
    title : str
        What was tested.
    judged : Judged
        The verdict and its reason.
    tables : tuple of ReportedTable
        The numbers behind it.
    kind : str
        The kind of the validation, "" where it is unknown.
    """

    title: str
    judged: ValidationOutcome
    tables: tuple[ReportedTable, ...] = ()
    kind: str = ""
