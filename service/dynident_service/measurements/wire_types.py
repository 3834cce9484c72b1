"""Bodies and answers of measurements and imports."""

from __future__ import annotations

import json
from datetime import datetime
from typing import Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, computed_field, model_serializer

from dynident.recordings.recording_metadata import EffortKind, RecordingMetadata, Revision, Role
from dynident_service.problems import RemedyView
from dynident_service.shared.request_bodies import derive_body
from dynident_service.shared.wire_types import Identifier, Labelled, Name, RequestModel, ViewModel


@derive_body(Revision, or_null=("columns", "units", "permutation", "signs", "scale", "zeros"))
class RevisionRequest(RequestModel):
    """Changes to the metadata of a measurement's file, which stays as it is. Fields that are not given stay, too.

    `columns`, `units`, `permutation`, `signs`, `scale` and `zeros` are merged with the earlier values, key by key.
    All fields but `role` and `name` are also fields of an upload's metadata.
    """

    name: Name | None = None

    @model_serializer(mode="wrap")
    def _drop_unset_fields(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {name: value for name, value in handler(self).items() if value is not None}


class SeenMeasurement(ViewModel):
    """A measurement as a model used it."""

    id: str
    name: str | None
    role: Literal["identification", "validation"]
    sha256: str = Field(description="Hash of the file as it was uploaded")
    revision: int = Field(description="0: as it was uploaded")
    parent_id: str | None = None
    edits: list[RevisionRequest] = Field(default=[], description="Changes to the metadata since the upload, in order")


@derive_body(RecordingMetadata)
class MeasurementMetadata(RequestModel):
    """Metadata of an uploaded file."""

    robot_id: Identifier
    name: Name


class CheckView(ViewModel):
    """One check, what it found, and what to do about it."""

    name: str
    status: Literal["ok", "warning", "error"]
    detail: str
    column: str = Field(default="", description="Column of the file")
    row: int | None = Field(default=None, description="Data row of the file, from 1")
    time: float | None = Field(default=None, description="Seconds of t")
    rows: dict[str, list[int]] = Field(
        default_factory=dict, description="By column of the file, its data rows, from 1; at most a thousand per column"
    )
    apply: RevisionRequest | None = Field(
        default=None,
        description="The correction, if it is known: a body for POST /v1/measurements/{id}/revisions; for a file that "
        "was refused, fields for the metadata of the next upload",
    )
    remedies: list[RemedyView] = Field(default=[], description="Remedies that the sentence names")
    remedy: RemedyView | None = Field(default=None, description="The first of them")

    @computed_field  # type: ignore[prop-decorator]
    @property
    def code(self) -> str:
        """The kind of finding: the name of the check."""
        return self.name

    @computed_field  # type: ignore[prop-decorator]
    @property
    def values(self) -> dict[str, str | int | float]:
        """Where the finding is: column, row, time, and number of rows; what is not known is left out."""
        known = {"column": self.column or None, "row": self.row, "time": self.time}
        count = sum(map(len, self.rows.values()))
        return {name: value for name, value in {**known, "rows": count or None}.items() if value is not None}


class SegmentView(ViewModel):
    """An interval of uniformly sampled rows; filters do not cross its ends."""

    start_time: float
    end_time: float
    n_samples: int
    label: int


class PhasesView(ViewModel):
    """Shares of time, 0 to 1, in which each joint stands still (or sticks) or reverses; otherwise it moves."""

    standing: list[float] = Field(
        description="Per joint: standstill, where friction may have any value, so its friction rows are not used"
    )
    reversing: list[float] = Field(
        description="Per joint: near reversals, where only rows of friction with memory of the path are used"
    )


class MeasurementResult(ViewModel):
    """The content of a recording."""

    sha256: str
    under_way: bool = Field(
        default=False, description="Whether rows are still to come; until then only the joints are known"
    )
    n_samples: int
    sampling_rate: float = Field(description="Hz, after resampling to a uniform grid")
    joints: list[str]
    segments: list[SegmentView]
    has_temperature: bool
    has_wrench: bool = Field(default=False, description="Whether the wrench of the base was recorded")
    has_command: bool = Field(
        default=False,
        description="Whether the commanded positions of all joints were recorded, for the estimators iv and didim",
    )
    phases: PhasesView | None = Field(
        default=None, description="Shares of each joint's time; null in measurements that an older version stored"
    )
    checks: list[CheckView]
    edits: list[RevisionRequest] = Field(
        default=[], description="Changes to the metadata since the upload, in order; [] if there are none"
    )


class ConditionedRows(ViewModel):
    """Rows of a column that were put right."""

    count: int = Field(description="At most a thousand are counted")
    first: list[int] = Field(description="The first ones: data rows of the file, from 1")


class ConditioningSubject(ViewModel):
    """What a correction was made in."""

    recording: str
    column: str = Field(description="Column of the file")
    joint: str | None = Field(description="null for a column of no joint")


class ConditioningView(ViewModel):
    """A correction that was made before the checks."""

    code: str
    subject: ConditioningSubject
    rows: ConditionedRows
    detail: str
    undo: RevisionRequest = Field(description="A body for POST /v1/measurements/{id}/revisions")


class MeasurementView(MeasurementResult, Labelled):
    """A stored measurement."""

    id: str
    name: str
    created_at: datetime
    robot_id: str
    role: Role | None
    windows: list[tuple[float, float]]
    parent_id: str | None = Field(default=None, description="The measurement that this one revises")
    revision: int = Field(default=0, description="Number of revisions between the upload and this measurement")
    effort_kind: EffortKind = Field(
        default="unknown", description="What its torque or current is, according to the metadata"
    )
    request: MeasurementMetadata
    conditioning: list[ConditioningView] = Field(
        default=[], description="What was put right before the checks, column by column, and how to undo it"
    )


class RawSignals(ViewModel):
    """Signals of a measurement's file, without filtering, repair or resampling."""

    units: dict[str, str] = Field(description="By signal; empty for a column that is given as it is in the file")
    t: list[float | None] = Field(description="s")
    signals: dict[str, list[float | None]] = Field(description="As long as t; null if there is no number")
    available: list[str] = Field(default=[], description="Signals of joints that the file has, by joint name")
    n_samples: int = Field(description="Number of samples from `from` to `to`, of which these are shown")


class StandstillsOfJoint(ViewModel):
    """Standstills of one joint."""

    joint: str
    standing: list[tuple[float, float]] = Field(description="Seconds of t, [from, to], in order")


class Standstills(ViewModel):
    """Standstills of every joint of a measurement: friction may have any value there."""

    joints: list[StandstillsOfJoint]


_KNOWN_BEFOREHAND = ("columns", "units", "role", "windows", "rate")


@derive_body(RecordingMetadata, only=_KNOWN_BEFOREHAND)
class ImportMetadata(RequestModel):
    """What is known about a file; the service does not guess these values."""

    robot_id: Identifier
    name: Name | None = Field(default=None, description="Name of the measurement; by default, the name of the file")


class GuessView(ViewModel):
    """A guess about the file."""

    field: str
    value: str
    confidence: float = Field(description="0 to 1")
    reason: str
    remedies: list[RemedyView] = Field(default=[], description="Those that the reason names")


class QuestionView(ViewModel):
    """A question that must be answered before the file can be used."""

    field: str
    detail: str
    choices: list[str] | None = None
    remedies: list[RemedyView] = Field(default=[], description="Those that the question names")


class PreviewView(ViewModel):
    """The first rows as they are in the file."""

    columns: list[str]
    rows: list[list[float | None]]
    sketch: list[list[float | None]] = Field(
        default=[], description="Some of the rows that were read, at even distances, for small drawings"
    )


class InspectionView(ViewModel):
    """What the inspection of a file found."""

    sha256: str
    format: str
    guesses: list[GuessView]
    questions: list[QuestionView]
    effort_kind: EffortKind
    preview: PreviewView


class ImportResult(InspectionView):
    """The same with proposed metadata, for `POST /v1/measurements`."""

    proposed: dict[str, Any] = Field(description="See MeasurementMetadata")


class ImportView(ImportResult):
    """A file that was inspected; it is stored for a day."""

    id: str
    created_at: datetime
    expires_at: datetime


class MeasurementOfImport(RequestModel):
    """A measurement from an imported file, without a second upload."""

    import_id: Identifier
    metadata: MeasurementMetadata


class MeasurementUnderWay(RequestModel):
    """A measurement whose rows come while it is recorded: `PATCH /v1/measurements/{id}/rows`."""

    under_way: Literal[True]
    metadata: MeasurementMetadata


ROWS = "rows"
"""Role of the object that holds the rows of a recording under way."""


def begins_recording(body: bytes) -> bool:
    """Return whether the body of POST /v1/measurements is a `MeasurementUnderWay`."""
    try:
        content = json.loads(body)
    except (ValueError, RecursionError):
        # What is wrong with it is told by the model of the other body.
        return False
    return isinstance(content, dict) and "under_way" in content


class LiveParameterView(ViewModel):
    """A parameter as it stands."""

    name: str
    link: str
    value: float
    unit: str
    standard_deviation: float | None
    judgement: str


class StopReasonView(ViewModel):
    """Why a recording under way is not worth going on with."""

    code: Literal["saturation", "torque_sign", "torque_order", "position_limit", "velocity_limit", "too_slow"]
    joint: str = Field(description='"" where it is about the whole recording')
    detail: str


class LiveEstimateView(ViewModel):
    """What a recording under way tells so far; an event `estimate` of its stream, or the last one, `finished`."""

    rows: int
    seconds: float
    equations: int = Field(description="Filtered rows that the estimate rests on, over all joints")
    parameters: list[LiveParameterView] = Field(description="[] as long as the rows do not determine them")
    reason: str = Field(description="Why there are no parameters yet")
    joints: list[str]
    error: list[float | None] | None = Field(description="Relative error of the torque left by the fit, by joint")
    predicted: list[float | None] | None = Field(
        description="Relative error with which the previous estimate predicted the newest rows, by joint"
    )
    stop: list[StopReasonView] = Field(description="Reasons to stop the robot; [] where the run is sound")


JSON_BODY = {
    "requestBody": {
        "content": {
            "application/json": {
                "schema": {
                    "type": "object",
                    "title": "MeasurementOfImport",
                    "required": ["metadata"],
                    "properties": {
                        "import_id": {"type": "string", "description": "A file that was imported before"},
                        "under_way": {
                            "type": "boolean",
                            "description": "true, instead of import_id: the rows will be sent by PATCH …/rows",
                        },
                        "metadata": {"$ref": "#/components/schemas/MeasurementMetadata"},
                    },
                }
            }
        },
        "required": True,
    }
}
"""Body of POST /v1/measurements beside the form."""
