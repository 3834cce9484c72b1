"""Job: validate a model."""

from __future__ import annotations

from dynident.validation.validation_request import ValidationData
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.shared.stored_inputs import load_stored_model, open_stored_recordings
from dynident_service.shared.wire_types import to_plain_json
from dynident_service.validations.adapters import describe_validation, trial_from_request
from dynident_service.validations.wire_types import ValidationRequest


def validate_model(task: Task) -> Outcome:
    """Validate a model by the requested test."""
    request = ValidationRequest.model_validate(task.subject.request)
    trial = trial_from_request(request)
    ids = task.subject.get_dependencies("measurement")
    trial_data = ValidationData(
        load_stored_model(task, request.identification_id),
        open_stored_recordings(task, ids),
        open_stored_recordings(task, task.subject.get_dependencies("training")),
        task.progress,
    )
    return Outcome(to_plain_json(describe_validation(trial, trial.judge(trial_data), ids)))
