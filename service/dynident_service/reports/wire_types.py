"""Bodies and answers of reports."""

from __future__ import annotations

from pydantic import Field

from dynident.reports.reported_data import ReportChoices
from dynident_service.shared.request_bodies import derive_body
from dynident_service.shared.wire_types import Computed, Identifier, NamedRequest, ViewModel


@derive_body(ReportChoices)
class ReportRequest(NamedRequest):
    """A request for a report."""

    identification_id: Identifier
    diagnosis_id: Identifier | None = Field(
        default=None, description="Diagnosis of this model or of one of its parents"
    )
    design_id: Identifier | None = Field(
        default=None,
        description="The design of the experiment: its expected accuracy is shown next to the achieved one",
    )
    validation_ids: list[Identifier] = Field(
        default=[], max_length=100, description="Validations of this model; the report shows their results"
    )
    measurement_ids: list[Identifier] | None = Field(
        default=None,
        min_length=1,
        max_length=100,
        description="Shown next to the prediction; by default, all measurements of the model",
    )


class ReportResult(ViewModel):
    """The report document."""

    media_type: str
    size: int = Field(description="Bytes")
    href: str


class ReportView(Computed[ReportRequest, ReportResult]):
    """A report."""
