"""Jobs that identify a model, extend it by effects or remove effects, and record which revisions of files it used."""

from __future__ import annotations

from dynident.identification import Identification, extend, identify, remove, to_bytes
from dynident_service.adapters.effects import choices_of
from dynident_service.adapters.identifications import choices_from_request, describe_identification
from dynident_service.jobs.work import Outcome, Task
from dynident_service.models.common import plain
from dynident_service.models.identifications import StoredIdentification
from dynident_service.models.revisions import SeenMeasurement
from dynident_service.work.means import model_by_id, recordings_by_id, robot_by_id


def identify_model(task: Task) -> Outcome:
    """Identify the base parameters of a robot from measurements."""
    subject = task.subject
    request = StoredIdentification.model_validate(subject.request)
    robot = robot_by_id(task, request.robot_id)
    training = recordings_by_id(task, request.measurement_ids)
    validation = recordings_by_id(task, request.validation_ids)
    choices = choices_from_request(request, robot, training)
    return _outcome(task, identify(robot, training, validation, choices, task.progress))


def extend_model(task: Task) -> Outcome:
    """Add effects to an identified model."""
    subject = task.subject
    parent_id = subject.one("parent")
    request = StoredIdentification.model_validate(subject.request)
    parent = model_by_id(task, parent_id)
    extended = extend(
        parent,
        choices_of(request.added),
        recordings_by_id(task, request.measurement_ids),
        recordings_by_id(task, request.validation_ids),
        task.progress,
    )
    return _outcome(task, extended, parent_id, parent)


def remove_from_model(task: Task) -> Outcome:
    """Remove effects from an identified model."""
    parent_id = task.subject.one("parent")
    request = StoredIdentification.model_validate(task.subject.request)
    parent = model_by_id(task, parent_id)
    return _outcome(task, remove(parent, choices_of(request.removed)), parent_id, parent)


def _outcome(
    task: Task, model: Identification, parent_id: str | None = None, parent: Identification | None = None
) -> Outcome:
    # The next job of this process, a diagnosis or a report, most probably needs the same model.
    task.memory.keep(Identification, task.subject.id, model)
    model_file = task.keep("model", to_bytes(model), "application/vnd.dynident.model+npz")
    described = describe_identification(model, parent_id, parent)
    return Outcome(plain(described.model_copy(update={"measurements": seen_measurements(task)})), (model_file,))


def seen_measurements(task: Task) -> list[SeenMeasurement]:
    """Return the measurements of the identification that a job computes, each with its hash and revision."""
    request = StoredIdentification.model_validate(task.subject.request)
    pairs = [("identification", identifier) for identifier in request.measurement_ids]
    return [
        _seen(task, role, identifier)
        for role, identifier in [*pairs, *(("validation", identifier) for identifier in request.validation_ids)]
    ]


def _seen(task: Task, role: str, identifier: str) -> SeenMeasurement:
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
            "parent_id": next(iter(measurement.all("parent")), None),
            "edits": edits,
        }
    )
