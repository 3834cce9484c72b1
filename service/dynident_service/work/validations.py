"""Jobs that validate an identified model."""

from __future__ import annotations

from dynident.validation.request import Tried
from dynident_service.adapters.validations import describe, trial_from_request
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.validations import ValidationRequest
from dynident_service.work.means import model_by_id, recordings_by_id


def validate_model(task: Task) -> Outcome:
    """Validate a model by the requested test."""
    request = ValidationRequest.model_validate(task.subject.request)
    trial = trial_from_request(request)
    ids = task.subject.all("measurement")
    trial_data = Tried(
        model_by_id(task, request.identification_id),
        recordings_by_id(task, ids),
        recordings_by_id(task, task.subject.all("training")),
        task.progress,
    )
    return Outcome(plain(describe(trial, trial.judge(trial_data), ids)))
