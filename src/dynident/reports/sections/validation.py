"""The section on the results of the model's validations (§12.7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynident.reports.section import Section
from dynident.reports.validated import ReportedValidation

_VERDICT_TEXTS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_VERDICT_MARKS = {"pass": "ok", "fail": "error", "not_evaluated": "warning"}


@dataclass(frozen=True)
class ValidationRow:
    """One validation in words; `mark` is the CSS class of its verdict."""

    validation: ReportedValidation
    verdict: str
    mark: str


@dataclass(frozen=True)
class ValidationContent:
    """The content of the section: all validations."""

    rows: tuple[ValidationRow, ...]


def build_validation_section(validations: Sequence[ReportedValidation]) -> Section:
    """Return the section on validations.

    Parameters
    ----------
    validations : sequence of ReportedValidation

    Returns
    -------
    Section
    """
    rows = tuple(
        ValidationRow(validation, _VERDICT_TEXTS[validation.judged.verdict], _VERDICT_MARKS[validation.judged.verdict])
        for validation in validations
    )
    return Section("validation", "Validation", "validation", ValidationContent(rows))
