"""Jobs that identify currents."""

from __future__ import annotations

from dynident.identification import identify_currents
from dynident.identification.loads.payload_data import PLAIN_EFFECTS
from dynident_service.adapters.conversion import from_wire_choices, to_view
from dynident_service.jobs.task import Outcome, Task
from dynident_service.wire_types.common import to_plain_json
from dynident_service.wire_types.drive_gains import CurrentModelsRequest, CurrentModelsResult
from dynident_service.work.stored_inputs import load_stored_robot, open_stored_recordings


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
