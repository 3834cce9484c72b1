"""Measurements on the wire: metadata and revisions, signals as they were recorded, inspected files."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer

from dynident.recordings.metadata import EffortKind, RecordingMetadata, Revision, Role
from dynident_service.models.common import Identifier, Labelled, Name, RequestModel, ViewModel
from dynident_service.models.request_bodies import derive_body


@derive_body(Revision, or_null=("columns", "units", "permutation", "signs", "scale"))
class RevisionRequest(RequestModel):
    """What is to be said of a measurement's file; the file stays as it is. What is not given stays as it was said.

    `columns`, `units`, `permutation`, `signs` and `scale` are merged with what was said, key by key. All fields but
    `role` and `name` are also fields of an upload's metadata.
    """

    name: Name | None = None

    @model_serializer(mode="wrap")
    def _drop_unset_fields(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in handler(self).items() if value is not None}


class SeenMeasurement(ViewModel):
    """A measurement as a model saw it."""

    id: str
    name: str | None
    role: Literal["identification", "validation"]
    sha256: str = Field(description="Of the file as it was uploaded")
    revision: int = Field(description="0: as it was uploaded")
    parent_id: str | None = None
    edits: list[RevisionRequest] = Field(default=[], description="What was said of the file since, in order")


@derive_body(RecordingMetadata)
class MeasurementMetadata(RequestModel):
    """What is said about an uploaded file."""

    robot_id: Identifier
    name: Name


class CheckView(ViewModel):
    """One thing that was looked at, what was found, and what to do about it."""

    name: str
    status: Literal["ok", "warning", "error"]
    detail: str
    column: str = Field(default="", description="Of the file")
    row: int | None = Field(default=None, description="Data row of the file, from 1")
    time: float | None = Field(default=None, description="Seconds of t")
    rows: dict[str, list[int]] = Field(
        default_factory=dict, description="By column of the file, its data rows, from 1; the first thousand of each"
    )
    apply: RevisionRequest | None = Field(
        default=None,
        description="What cures it, where that is known: a body for POST /v1/measurements/{id}/revisions; of a file "
        "that was refused, fields for the metadata of another try",
    )


class SegmentView(ViewModel):
    """A stretch of uniformly sampled rows that nothing is filtered across."""

    start_time: float
    end_time: float
    n_samples: int
    label: int


class PhasesView(ViewModel):
    """Shares, 0 to 1, of what each joint does: it stands (or sticks), turns round, or else moves."""

    standing: list[float] = Field(description="Per joint: no rows of its friction, which may hold any torque there")
    reversing: list[float] = Field(description="Per joint: rows of friction that remembers the path alone")


class MeasurementResult(ViewModel):
    """What is in a recording."""

    sha256: str
    n_samples: int
    sampling_rate: float = Field(description="Hz, after resampling to a uniform grid")
    joints: list[str]
    segments: list[SegmentView]
    has_temperature: bool
    has_wrench: bool = Field(default=False, description="Whether the wrench of the base was recorded")
    has_command: bool = Field(
        default=False, description="Whether the commanded positions of all joints were recorded, for iv and didim"
    )
    phases: PhasesView | None = Field(
        default=None, description="Shares of each joint's time; null in measurements that an older version stored"
    )
    checks: list[CheckView]
    edits: list[RevisionRequest] = Field(
        default=[], description="What was said of the file since it was uploaded, in order; [] if nothing"
    )


class MeasurementView(MeasurementResult, Labelled):
    """A stored measurement."""

    id: str
    name: str
    created_at: datetime
    robot_id: str
    role: Role | None
    windows: list[tuple[float, float]]
    parent_id: str | None = Field(default=None, description="The measurement that this one is a revision of")
    revision: int = Field(default=0, description="How many edits lie between the upload and this measurement")
    effort_kind: EffortKind = Field(default="unknown", description="What its torque or current was said to be")
    request: MeasurementMetadata


class RawSignals(ViewModel):
    """Signals of a measurement's file; nothing is filtered, mended or resampled."""

    units: dict[str, str] = Field(description="By signal; empty for a column of the file that is given as it stands")
    t: list[float | None] = Field(description="s")
    signals: dict[str, list[float | None]] = Field(description="As long as t; null where there is no number")
    n_samples: int = Field(description="How many there are from `from` to `to`, of which these are shown")


class StandstillsOfJoint(ViewModel):
    """When one joint stands."""

    joint: str
    standing: list[tuple[float, float]] = Field(description="Seconds of t, [from, to], one after another")


class Standstills(ViewModel):
    """When every joint of a measurement stands: there friction may hold any torque."""

    joints: list[StandstillsOfJoint]


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
