"""How the model's validations ended (§12.7)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from dynident.reports.section import Section
from dynident.reports.validated import ReportedValidation

_WORDS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_MARKS = {"pass": "ok", "fail": "error", "not_evaluated": "warning"}


@dataclass(frozen=True)
class ValidationRow:
    """One validation in words; `mark` is how its verdict is set."""

    validation: ReportedValidation
    verdict: str
    mark: str


@dataclass(frozen=True)
class ValidationContent:
    """All validations."""

    rows: tuple[ValidationRow, ...]


def validation_section(validations: Sequence[ReportedValidation]) -> Section:
    """Whether the model is to be trusted."""
    rows = tuple(ValidationRow(one, _WORDS[one.judged.verdict], _MARKS[one.judged.verdict]) for one in validations)
    return Section("validation", "Validation", "validation", ValidationContent(rows))
