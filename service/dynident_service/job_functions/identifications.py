"""Jobs: identify, extend, remove effects; which revisions of measurements were used."""

from __future__ import annotations

from dynident.identification import Identification, extend, identify, remove, to_bytes
from dynident_service.adapters.field_by_field import from_wire_choices
from dynident_service.adapters.identifications import describe_identification, to_choices
from dynident_service.job_functions.stored_inputs import load_stored_model, load_stored_robot, open_stored_recordings
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.wire_types.identifications import StoredIdentification
from dynident_service.wire_types.measurements import SeenMeasurement
from dynident_service.wire_types.shared_types import to_plain_json


def identify_model(task: Task) -> Outcome:
    """Identify the base parameters of a robot from measurements."""
    subject = task.subject
    request = StoredIdentification.model_validate(subject.request)
    robot = load_stored_robot(task, request.robot_id)
    training = open_stored_recordings(task, request.measurement_ids)
    validation = open_stored_recordings(task, request.validation_ids)
    # Filters that the user left open are chosen from these recordings.
    choices = to_choices(request, robot, training)
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
