"""Reports on the wire."""

from __future__ import annotations

from pydantic import Field

from dynident.reports.request import ReportChoices
from dynident_service.models.common import Computed, Identifier, NamedRequest, ViewModel
from dynident_service.models.request_bodies import derive_body


@derive_body(ReportChoices)
class ReportRequest(NamedRequest):
    """What is to be reported."""

    identification_id: Identifier
    diagnosis_id: Identifier | None = Field(default=None, description="Of this model or of one it came from")
    design_id: Identifier | None = Field(
        default=None, description="The experiment: its promises are shown beside what was achieved"
    )
    validation_ids: list[Identifier] = Field(
        default=[], max_length=100, description="Validations of this model: how each of them ended"
    )
    measurement_ids: list[Identifier] | None = Field(
        default=None, min_length=1, max_length=100, description="Shown beside the prediction; else all it knows"
    )


class ReportResult(ViewModel):
    """The document that was made."""

    media_type: str
    size: int = Field(description="Bytes")
    href: str


class ReportView(Computed[ReportRequest, ReportResult]):
    """A report."""
