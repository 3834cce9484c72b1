"""Files that were looked at, on the wire."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from pydantic import Field

from dynident.recordings.metadata import EffortKind, RecordingMetadata
from dynident_service.models.common import Identifier, Name, RequestModel, ViewModel
from dynident_service.models.measurements import MeasurementMetadata
from dynident_service.models.request_bodies import derive_body

_KNOWN_BEFOREHAND = ("columns", "units", "role", "windows", "rate")


@derive_body(RecordingMetadata, only=_KNOWN_BEFOREHAND)
class ImportMetadata(RequestModel):
    """What is known of a file beforehand; whatever is said here is not guessed."""

    robot_id: Identifier
    name: Name | None = Field(default=None, description="What to call it; else as the file is called")


class GuessView(ViewModel):
    """One thing that was guessed."""

    field: str
    value: str
    confidence: float = Field(description="0 to 1")
    reason: str


class QuestionView(ViewModel):
    """What has to be answered before the file can be used."""

    field: str
    detail: str
    choices: list[str] | None = None


class PreviewView(ViewModel):
    """The first rows as they are in the file."""

    columns: list[str]
    rows: list[list[float | None]]


class InspectionView(ViewModel):
    """What was found in a file."""

    sha256: str
    format: str
    guesses: list[GuessView]
    questions: list[QuestionView]
    effort_kind: EffortKind
    preview: PreviewView


class ImportResult(InspectionView):
    """The same with the metadata that are proposed, for `POST /v1/measurements`."""

    proposed: dict[str, Any] = Field(description="See MeasurementMetadata")


class ImportView(ImportResult):
    """A file that was looked at, and is kept for a day."""

    id: str
    created_at: datetime
    expires_at: datetime


class MeasurementOfImport(RequestModel):
    """A measurement of a file that was imported; nothing is uploaded twice."""

    import_id: Identifier
    metadata: MeasurementMetadata
