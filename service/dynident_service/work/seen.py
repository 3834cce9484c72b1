"""Which revision of which file a model saw."""

from __future__ import annotations

from dynident_service.jobs.work import Task
from dynident_service.models.identifications import StoredIdentification
from dynident_service.models.revisions import SeenMeasurement


def seen_measurements(task: Task) -> list[SeenMeasurement]:
    """Tell of all measurements of the identification that a job computes."""
    request = StoredIdentification.model_validate(task.subject.request)
    pairs = [("identification", one) for one in request.measurement_ids]
    return [_seen(task, role, one) for role, one in [*pairs, *(("validation", one) for one in request.validation_ids)]]


def _seen(task: Task, role: str, identifier: str) -> SeenMeasurement:
    found = task.resources.get("measurement", identifier)
    result = found.result or {}
    edits = result.get("edits", [])
    return SeenMeasurement.model_validate(
        {
            "id": found.id,
            "name": found.name,
            "role": role,
            "sha256": result.get("sha256", ""),
            "revision": len(edits),
            "parent_id": next(iter(found.all("parent")), None),
            "edits": edits,
        }
    )
