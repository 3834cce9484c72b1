"""Jobs that try an identified model."""

from __future__ import annotations

from dynident.diagnosis import compare
from dynident.progress import part
from dynident_service.adapters.identifications import finite, show_errors
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.validations import MeasurementErrors, ValidationRequest, ValidationResult
from dynident_service.work.means import model_by_id, recording_by_id


def validate_model(task: Task) -> Outcome:
    """Try a model by the test that was asked for."""
    request = ValidationRequest.model_validate(task.subject.request)
    model = model_by_id(task, request.identification_id)
    if request.kind == "inertia_matrix":
        result = ValidationResult(
            kind=request.kind,
            inertia_matrix_positive_definite=model.inertia_matrix_positive_definite,
            smallest_eigenvalue=finite(model.worst_inertia_eigenvalue),
        )
        return Outcome(plain(result))
    measurement_ids = task.subject.all("measurement")
    tried = []
    for index, identifier in enumerate(measurement_ids):
        progress = part(task.progress, index / len(measurement_ids), (index + 1) / len(measurement_ids))
        recording = recording_by_id(task, identifier)
        errors = show_errors(compare(model, recording, progress).errors)
        tried.append(MeasurementErrors(measurement_id=identifier, name=recording.name, errors=errors))
    return Outcome(plain(ValidationResult(kind=request.kind, measurements=tried)))
