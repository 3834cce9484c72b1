"""Job: identify a model in units of current."""

from __future__ import annotations

from dynident.identification import identify_currents
from dynident.identification.loads.payloads_of_recordings import PLAIN_EFFECTS
from dynident_service.adapters.field_by_field import from_wire_choices, to_view
from dynident_service.job_functions.stored_inputs import load_stored_robot, open_stored_recordings
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.wire_types.drive_gains import CurrentModelsRequest, CurrentModelsResult
from dynident_service.wire_types.shared_types import to_plain_json


def find_currents(task: Task) -> Outcome:
    """Identify every joint's parameters in units of its current."""
    request = CurrentModelsRequest.model_validate(task.subject.request)
    joint_models = identify_currents(
        load_stored_robot(task, request.robot_id),
        open_stored_recordings(task, request.measurement_ids),
        open_stored_recordings(task, request.validation_ids),
        effects=from_wire_choices(request.effects) if request.effects else PLAIN_EFFECTS,
        progress=task.progress,
    )
    return Outcome(to_plain_json(to_view(CurrentModelsResult, None, joints=joint_models)))
