"""Jobs that identify currents."""

from __future__ import annotations

from dynident.identification import identify_currents
from dynident.identification.loads.payloads import PLAIN_EFFECTS
from dynident_service.adapters.answers import shown
from dynident_service.adapters.effects import choices_of
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.current_models import CurrentModelsRequest, CurrentModelsResult
from dynident_service.work.means import recordings_by_id, robot_by_id


def find_currents(task: Task) -> Outcome:
    """Identify every joint's parameters in units of its current."""
    request = CurrentModelsRequest.model_validate(task.subject.request)
    joint_models = identify_currents(
        robot_by_id(task, request.robot_id),
        recordings_by_id(task, request.measurement_ids),
        recordings_by_id(task, request.validation_ids),
        effects=choices_of(request.effects) if request.effects else PLAIN_EFFECTS,
        progress=task.progress,
    )
    return Outcome(plain(shown(CurrentModelsResult, None, joints=joint_models)))
