"""What child processes compute of models: jobs that identify, extend, remove effects; verdict, correlation, exports.

Holds how recordings of a verdict with the same name are told apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypedDict

import numpy as np

from dynident.array_types import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.export import ExportedFile, ExportFormat, compute_held_out_error, export_model
from dynident.export.export_request import FORMATS
from dynident.identification import Identification, extend, from_bytes, identify, remove, to_bytes
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    essential_parameters,
    parameter_dependence,
)
from dynident.identification.identified_models.torque_prediction import predict
from dynident.recordings import Check, open_recording
from dynident.recordings.recording_metadata import Status
from dynident.schema.fields import Choice
from dynident.validation import ValidationOutcome, Verdict
from dynident.verdict import Outcome as EndedValidation
from dynident.verdict import verdict
from dynident_service.identifications.adapters import (
    OpenedMeasurement,
    describe_essential,
    describe_identification,
    export_file,
    show_verdict,
    to_choices,
)
from dynident_service.identifications.wire_types import (
    CorrelationView,
    ExportsView,
    ExportView,
    PredictionRequest,
    StoredIdentification,
)
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.measurements.adapters import to_recording_metadata
from dynident_service.measurements.wire_types import MeasurementMetadata, SeenMeasurement
from dynident_service.shared.field_by_field import from_wire_choices, to_view
from dynident_service.shared.stored_inputs import load_stored_model, load_stored_robot, open_stored_recordings
from dynident_service.shared.wire_types import to_plain_json


def identify_model(task: Task) -> Outcome:
    """Identify the base parameters of a robot from measurements."""
    subject = task.subject
    request = StoredIdentification.model_validate(subject.request)
    robot = load_stored_robot(task, request.robot_id)
    training = open_stored_recordings(task, request.measurement_ids)
    validation = open_stored_recordings(task, request.validation_ids)
    # Filters that the user left open are chosen from these recordings.
    choices = to_choices(request, training)
    return _build_outcome(task, identify(robot, training, validation, choices, task.progress))


def extend_model(task: Task) -> Outcome:
    """Add effects to an identified model."""
    subject = task.subject
    parent_id = subject.get_dependency("parent")
    request = StoredIdentification.model_validate(subject.request)
    parent = load_stored_model(task, parent_id)
    extended = extend(
        parent,
        from_wire_choices(request.added),
        open_stored_recordings(task, request.measurement_ids),
        open_stored_recordings(task, request.validation_ids),
        task.progress,
    )
    return _build_outcome(task, extended, parent_id, parent)


def remove_from_model(task: Task) -> Outcome:
    """Remove effects from an identified model."""
    parent_id = task.subject.get_dependency("parent")
    request = StoredIdentification.model_validate(task.subject.request)
    parent = load_stored_model(task, parent_id)
    return _build_outcome(task, remove(parent, from_wire_choices(request.removed)), parent_id, parent)


def _build_outcome(
    task: Task, model: Identification, parent_id: str | None = None, parent: Identification | None = None
) -> Outcome:
    # The next job of this process, a diagnosis or a report, most probably needs the same model.
    task.memory.put(Identification, task.subject.id, model)
    model_file = task.store_file("model", to_bytes(model), "application/vnd.dynident.model+npz")
    described = describe_identification(model, parent_id, parent)
    return Outcome(
        to_plain_json(described.model_copy(update={"measurements": describe_measurements(task)})), (model_file,)
    )


def describe_measurements(task: Task) -> list[SeenMeasurement]:
    """Return the measurements of the identification that a job computes, each with its hash and revision."""
    request = StoredIdentification.model_validate(task.subject.request)
    pairs = [("identification", identifier) for identifier in request.measurement_ids]
    return [
        _describe_measurement(task, role, identifier)
        for role, identifier in [*pairs, *(("validation", identifier) for identifier in request.validation_ids)]
    ]


def _describe_measurement(task: Task, role: str, identifier: str) -> SeenMeasurement:
    measurement = task.resources.get("measurement", identifier)
    result = measurement.result or {}
    edits = result.get("edits", [])
    return SeenMeasurement.model_validate(
        {
            "id": measurement.id,
            "name": measurement.name,
            "role": role,
            "sha256": result.get("sha256", ""),
            "revision": len(edits),
            "parent_id": next(iter(measurement.get_dependencies("parent")), None),
            "edits": edits,
        }
    )


class SentCheck(TypedDict):
    """Check of a recording, as sent to the child process."""

    name: str
    status: Status
    detail: str


class SentMeasurement(TypedDict):
    """Measurement as sent to the child process; `recording` is a path."""

    id: str
    recording: str
    request: Mapping[str, object]
    checks: Sequence[SentCheck]


class SentOutcome(TypedDict):
    """Finished validation, as sent to the child process."""

    kind: str
    verdict: Verdict
    reason: str


def judge_model(
    model: str,
    fitted: Sequence[SentMeasurement],
    held_out: Sequence[SentMeasurement],
    outcomes: Sequence[SentOutcome] = (),
) -> dict[str, object]:
    """Return what the model in a file is fit for."""
    names: set[str] = set()
    opened = (
        [_open_measurement(measurement, names) for measurement in fitted],
        [_open_measurement(measurement, names) for measurement in held_out],
    )
    pairs = zip([*opened[0], *opened[1]], [*fitted, *held_out], strict=True)
    checks = {measurement.recording.name: build_checks(sent) for measurement, sent in pairs}
    recordings, validation = ([measurement.recording for measurement in group] for group in opened)
    ended = [
        EndedValidation(outcome["kind"], ValidationOutcome(outcome["verdict"], outcome["reason"]))
        for outcome in outcomes
    ]
    result = verdict(from_bytes(Path(model).read_bytes()), recordings, validation, checks, ended)
    return to_plain_json(show_verdict(result, [*opened[0], *opened[1]]))


def build_checks(measurement: SentMeasurement) -> list[Check]:
    """Build the checks of a measurement; whether one is accepted is stated by its request."""
    accepted = to_recording_metadata(MeasurementMetadata.model_validate(measurement["request"])).accept
    return [
        Check(check["name"], check["status"], check["detail"], is_accepted=check["name"] in accepted)
        for check in measurement["checks"]
    ]


def _open_measurement(measurement: SentMeasurement, names: set[str]) -> OpenedMeasurement:
    recording = open_recording(Path(measurement["recording"]))
    # The verdict refers to recordings by name, and two measurements may have the same one.
    name = recording.name if recording.name not in names else f"{recording.name} ({measurement['id']})"
    names.add(name)
    return OpenedMeasurement(
        measurement["id"], replace(recording, name=name), MeasurementMetadata.model_validate(measurement["request"])
    )


def essential(model: str, ratio: float) -> dict[str, object]:
    """Return the essential parameters of the model in a file."""
    return to_plain_json(describe_essential(essential_parameters(_read_model(model), ratio)))


def correlation(model: str) -> dict[str, object]:
    """Return how the estimates of the model in a file depend on one another."""
    return to_plain_json(to_view(CorrelationView, parameter_dependence(_read_model(model))))


def predict_torque(model: str, request: Mapping[str, object]) -> dict[str, object]:
    """Return the torque that the model in a file predicts."""
    sent = PredictionRequest.model_validate(request)
    q, dq, ddq = (_to_rows(name, rows) for name, rows in (("q", sent.q), ("dq", sent.dq), ("ddq", sent.ddq)))
    t = None if sent.t is None else np.array(sent.t)
    if t is not None and (len(t) != len(q) or (np.diff(t) <= 0).any()):
        raise DynidentError(f"give {len(q)} times that increase, one for each sample", pointer="/t")
    identification = _read_model(model)
    predicted = predict(identification.estimate, q, dq, ddq, level=sent.interval or 0.95, t=t, is_steady=sent.steady)
    intervals = {}
    if sent.interval is not None:
        intervals = {
            "lower": predicted.lower,
            "upper": predicted.upper,
            "model_lower": predicted.torque - predicted.mean_half_width,
            "model_upper": predicted.torque + predicted.mean_half_width,
        }
    robot = identification.model.robot
    return {
        "joints": list(robot.joint_names),
        **{
            name: _show_rows(rows, robot.has_torque) for name, rows in {"torque": predicted.torque, **intervals}.items()
        },
    }


def _show_rows(rows: FloatArray, has_torque: BoolArray) -> list[list[float | None]]:
    """Return rows with None for joints that the model has no equation of: it predicts nothing, and not zero."""
    if has_torque.all():
        listed: list[list[float | None]] = rows.tolist()
        return listed
    return [[value if known else None for value, known in zip(row, has_torque, strict=True)] for row in rows.tolist()]


def _to_rows(name: str, rows: Sequence[Sequence[float]]) -> FloatArray:
    if len({len(row) for row in rows}) != 1:
        raise DynidentError("the rows differ in length; give one value for each joint in every row", pointer=f"/{name}")
    return np.array(rows)


def export(model: str, format: ExportFormat, nearest: bool, shown: Mapping[str, object]) -> ExportedFile:
    """Write the model in a file in another format."""
    return export_file(_read_model(model), format, nearest, dict(shown))


def list_exports(model: str) -> dict[str, object]:
    """Return the formats that the model in a file can be written in, with the error of each on held-out data."""
    identification = _read_model(model)
    error = compute_held_out_error(identification)
    items = [_try_export(identification, choice) for choice in FORMATS.choices]
    return to_plain_json(ExportsView(items=items, held_out_error=error))


def _try_export(identification: Identification, choice: Choice) -> ExportView:
    file, refusal = None, None
    try:
        file = export_model(identification, choice.name)
    except DynidentError as error:
        refusal = error.detail
    return ExportView(
        format=choice.name,
        title=choice.label,
        contains=choice.words,
        held_out_error=None if file is None else file.held_out_error,
        notes=[] if file is None else list(file.notes),
        refusal=refusal,
    )


def _read_model(model: str) -> Identification:
    return from_bytes(Path(model).read_bytes())
