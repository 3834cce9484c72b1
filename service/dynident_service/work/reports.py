"""Jobs that write a report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from dynident.diagnosis import compare
from dynident.encoding import encode_text
from dynident.excitation import Design
from dynident.identification import Identification
from dynident.progress import part
from dynident.reports import ReportedRun, ReportedValidation, html_report, pdf_of
from dynident.reports.stated import MEDIA_TYPES, ReportChoices
from dynident_service.adapters.answers import show_errors, show_figures
from dynident_service.adapters.derived import taken
from dynident_service.adapters.designs import design_of
from dynident_service.adapters.diagnoses import diagnosis_of
from dynident_service.adapters.revisions import checks_of, metadata_of, revision_of
from dynident_service.adapters.validation_tables import reported
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.identifications import StoredIdentification
from dynident_service.models.measurements import MeasurementMetadata, MeasurementResult
from dynident_service.models.reports import ReportRequest, ReportResult
from dynident_service.models.validations import ValidationResult
from dynident_service.storage.records import Resource
from dynident_service.work.means import model_by_id, recording_by_id


def write_report(task: Task) -> Outcome:
    """Write the report of an identified model."""
    subject = task.subject
    request = ReportRequest.model_validate(subject.request)
    identification = task.resources.get("identification", request.identification_id)
    diagnosis = task.resources.get("diagnosis", request.diagnosis_id) if request.diagnosis_id is not None else None
    runs = _runs(task, request, identification)
    task.progress(0.8, "writing")
    choices = taken(request, ReportChoices)
    if choices.format == "json":
        content = json.dumps(_document(task, request, diagnosis, runs), indent=1).encode()
    else:
        diagnosed = None if diagnosis is None or diagnosis.result is None else diagnosis_of(diagnosis.result)
        model = model_by_id(task, identification.id)
        design = _design(task, request.design_id)
        validations = _validations(task, request, model)
        page = html_report(
            model,
            runs,
            diagnosis=diagnosed,
            design=design,
            validations=validations,
            title=choices.name,
            address=str(task.arguments.get("address", "")),
        )
        content = pdf_of(page) if choices.format == "pdf" else encode_text(page)
    media_type = MEDIA_TYPES[choices.format]
    document = task.keep("content", content, media_type)
    href = f"/v1/reports/{subject.id}/content"
    return Outcome(plain(ReportResult(media_type=media_type, size=document.size, href=href)), (document,))


def _runs(task: Task, request: ReportRequest, identification: Resource) -> list[ReportedRun]:
    """Return the recordings to show, each with the model's prediction."""
    model: Identification = model_by_id(task, identification.id)
    model_request = StoredIdentification.model_validate(identification.request)
    measurement_ids = request.measurement_ids or [*model_request.measurement_ids, *model_request.validation_ids]
    runs = []
    for index, identifier in enumerate(measurement_ids):
        progress = part(task.progress, 0.8 * index / len(measurement_ids), 0.8 * (index + 1) / len(measurement_ids))
        recording = recording_by_id(task, identifier)
        held_out = identifier not in model_request.measurement_ids
        stored = task.resources.get("measurement", identifier)
        measurement_result = MeasurementResult.model_validate(stored.result)
        metadata = metadata_of(MeasurementMetadata.model_validate(stored.request))
        checks, edits = (
            checks_of(measurement_result.checks),
            tuple(revision_of(edit) for edit in measurement_result.edits),
        )
        compared = compare(model, recording, progress)
        runs.append(ReportedRun(recording, compared, held_out, checks, edits, measurement_result.sha256, metadata))
    return runs


def _design(task: Task, identifier: str | None) -> Design | None:
    """Return the designed experiment, or None if the report has none."""
    if identifier is None:
        return None
    stored = task.resources.get("design", identifier)
    return design_of(stored.request, stored.result or {}, task.objects.path(stored.objects["trajectory"].key))


def _validations(task: Task, request: ReportRequest, model: Identification) -> list[ReportedValidation]:
    """Return the results of the validations to show."""
    joints = model.model.robot.joint_names
    stored = [task.resources.get("validation", identifier).result for identifier in request.validation_ids]
    return [reported(ValidationResult.model_validate(result), joints) for result in stored]


def _document(
    task: Task, request: ReportRequest, diagnosis: Resource | None, runs: Sequence[ReportedRun]
) -> dict[str, Any]:
    return {
        "identification": _shown(task.resources.get("identification", request.identification_id)),
        "validations": [_shown(task.resources.get("validation", identifier)) for identifier in request.validation_ids],
        "diagnosis": None if diagnosis is None else _shown(diagnosis),
        "measurements": [
            {
                "name": run.name,
                "held_out": run.held_out,
                "n_samples": run.recording.n_samples,
                "errors": plain(show_errors(run.comparison.errors, run.comparison.moving_errors)),
                "raw": plain(show_figures(run.comparison.raw_errors)),
            }
            for run in runs
        ],
    }


def _shown(resource: Resource) -> dict[str, Any]:
    return {
        "id": resource.id,
        "name": resource.name,
        "created_at": resource.created_at.isoformat(),
        "request": resource.request,
        "result": resource.result,
    }
