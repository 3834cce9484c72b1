"""Job: write a report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from dynident.diagnosis import compare
from dynident.excitation import Design
from dynident.identification import Identification
from dynident.progress import scale_progress
from dynident.reports import ReportedRecording, ReportedValidation, html_report, render_pdf
from dynident.reports.reported_data import MEDIA_TYPES, ReportChoices
from dynident.text_encoding import encode_text
from dynident_service.designs.adapters import restore_design
from dynident_service.diagnoses.adapters import restore_diagnosis
from dynident_service.identifications.wire_types import StoredIdentification
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.measurements.adapters import restore_checks, to_recording_metadata, to_revision
from dynident_service.measurements.wire_types import MeasurementMetadata, MeasurementResult
from dynident_service.reports.wire_types import ReportRequest, ReportResult
from dynident_service.shared.field_by_field import show_errors, show_figures, to_request
from dynident_service.shared.required_resources import add_next_experiment
from dynident_service.shared.stored_inputs import load_stored_model, open_recording_by_id
from dynident_service.shared.wire_types import to_plain_json
from dynident_service.storage.repository_values import Resource
from dynident_service.validations.adapters import build_reported_validation
from dynident_service.validations.wire_types import ValidationResult


def write_report(task: Task) -> Outcome:
    """Write the report of an identified model."""
    subject = task.subject
    request = ReportRequest.model_validate(subject.request)
    identification = task.resources.get("identification", request.identification_id)
    diagnosis = None
    if request.diagnosis_id is not None:
        diagnosis = add_next_experiment(task.resources, task.resources.get("diagnosis", request.diagnosis_id))
    runs = _load_runs(task, request, identification)
    task.progress(0.8, "writing")
    choices = to_request(request, ReportChoices)
    # For programs: the stored results as they are, without figures.
    if choices.format == "json":
        content = json.dumps(_build_document(task, request, diagnosis, runs), indent=1).encode()
    else:
        diagnosed = None if diagnosis is None or diagnosis.result is None else restore_diagnosis(diagnosis.result)
        model = load_stored_model(task, identification.id)
        design = _load_design(task, request.design_id)
        validations = _load_validations(task, request, model)
        page = html_report(
            model,
            runs,
            diagnosis=diagnosed,
            design=design,
            validations=validations,
            title=choices.name,
            address=str(task.arguments.get("address", "")),
        )
        content = render_pdf(page) if choices.format == "pdf" else encode_text(page)
    media_type = MEDIA_TYPES[choices.format]
    document = task.store_file("content", content, media_type)
    href = f"/v1/reports/{subject.id}/content"
    return Outcome(to_plain_json(ReportResult(media_type=media_type, size=document.size, href=href)), (document,))


def _load_runs(task: Task, request: ReportRequest, identification: Resource) -> list[ReportedRecording]:
    """Return the recordings to show, each with the model's prediction."""
    model: Identification = load_stored_model(task, identification.id)
    model_request = StoredIdentification.model_validate(identification.request)
    measurement_ids = request.measurement_ids or [*model_request.measurement_ids, *model_request.validation_ids]
    runs = []
    for index, identifier in enumerate(measurement_ids):
        progress = scale_progress(
            task.progress, 0.8 * index / len(measurement_ids), 0.8 * (index + 1) / len(measurement_ids)
        )
        recording = open_recording_by_id(task, identifier)
        # A recording that the user adds was not fitted to, either.
        held_out = identifier not in model_request.measurement_ids
        stored = task.resources.get("measurement", identifier)
        measurement_result = MeasurementResult.model_validate(stored.result)
        metadata = to_recording_metadata(MeasurementMetadata.model_validate(stored.request))
        checks, edits = (
            restore_checks(measurement_result.checks),
            tuple(to_revision(edit) for edit in measurement_result.edits),
        )
        compared = compare(model, recording, progress)
        runs.append(
            ReportedRecording(recording, compared, held_out, checks, edits, measurement_result.sha256, metadata)
        )
    return runs


def _load_design(task: Task, identifier: str | None) -> Design | None:
    """Return the designed experiment, or None if the report has none."""
    if identifier is None:
        return None
    stored = task.resources.get("design", identifier)
    return restore_design(
        stored.request, stored.result or {}, task.objects.fetch_file(stored.objects["trajectory"].key)
    )


def _load_validations(task: Task, request: ReportRequest, model: Identification) -> list[ReportedValidation]:
    """Return the results of the validations to show."""
    joints = model.model.robot.joint_names
    stored = [task.resources.get("validation", identifier).result for identifier in request.validation_ids]
    return [build_reported_validation(ValidationResult.model_validate(result), joints) for result in stored]


def _build_document(
    task: Task, request: ReportRequest, diagnosis: Resource | None, runs: Sequence[ReportedRecording]
) -> dict[str, Any]:
    return {
        "identification": _to_document(task.resources.get("identification", request.identification_id)),
        "validations": [
            _to_document(task.resources.get("validation", identifier)) for identifier in request.validation_ids
        ],
        "diagnosis": None if diagnosis is None else _to_document(diagnosis),
        "measurements": [
            {
                "name": run.name,
                "held_out": run.held_out,
                "n_samples": run.recording.n_samples,
                "errors": to_plain_json(show_errors(run.comparison.errors, run.comparison.moving_errors)),
                "raw": to_plain_json(show_figures(run.comparison.raw_errors)),
            }
            for run in runs
        ],
    }


def _to_document(resource: Resource) -> dict[str, Any]:
    return {
        "id": resource.id,
        "name": resource.name,
        "created_at": resource.created_at.isoformat(),
        "request": resource.request,
        "result": resource.result,
    }
