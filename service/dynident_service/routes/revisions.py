"""Revisions of measurements: something else is said of the same file, and nothing is uploaded."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from anyio import to_thread
from fastapi import APIRouter, Request, Response

from dynident_service.models.common import to_plain_json
from dynident_service.models.measurements import MeasurementMetadata, MeasurementView, RevisionRequest
from dynident_service.preload import hold_import_lock
from dynident_service.problems import Problem, ProblemError, make_unusable
from dynident_service.routes.measurements import ReceivedFile, check_and_store, find_original
from dynident_service.routes.paging_and_retries import RetryKeyDep
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import Resource, Retry

router = APIRouter(prefix="/v1/measurements", tags=["measurements"])

_NUMBERED = re.compile(r" r\d+$")


@router.post("/{measurement_id}/revisions", status_code=201)
async def revise_measurement(
    measurement_id: str,
    body: RevisionRequest,
    request: Request,
    services: ServicesDep,
    retry: RetryKeyDep,
    response: Response,
) -> MeasurementView:
    """Change the metadata of a measurement's file: makes a new measurement, checked again, whose parent is this one."""
    with services.create_scratch_folder() as folder:
        received = await to_thread.run_sync(
            _prepare_revision, services, measurement_id, body, folder, retry.bind_to_body(body)
        )
        try:
            return await check_and_store(request, services, received, response)
        except ProblemError as error:
            raise _repoint_to_body(error.problem) from error


def _prepare_revision(
    services: Services, measurement_id: str, body: RevisionRequest, folder: Path, key: Retry | None
) -> ReceivedFile | Resource:
    parent = services.resources.get("measurement", measurement_id)
    if (existing := services.resources.find_retried(key)) is not None:
        return existing
    metadata, edits = _merge_revision(parent, body)
    original = find_original(parent)
    sha256 = original.key if parent.result is None else parent.result["sha256"]
    robot = services.resources.get("robot", metadata.robot_id).request
    source = services.objects.fetch_file(original.key)
    return ReceivedFile(metadata, source, folder, sha256, key, robot, parent=parent, edits=edits)


def _merge_revision(parent: Resource, body: RevisionRequest) -> tuple[MeasurementMetadata, list[dict[str, Any]]]:
    """Return what is said of the file from now on, and all that was said anew since it was uploaded."""
    with hold_import_lock():
        from dynident_service.adapters.measurements import apply_revision

    change = to_plain_json(body)
    if not change:
        raise make_unusable("give at least one field to change", "/", title="Nothing to revise")
    edits = [*(parent.result or {}).get("edits", []), change]
    # The number counts all revisions of the file: a revision of "run1 r2" is "run1 r3".
    own_name = f"{_NUMBERED.sub('', parent.name or 'measurement')[:190]} r{len(edits)}"
    return apply_revision(
        MeasurementMetadata.model_validate(parent.request), body.model_copy(update={"name": body.name or own_name})
    ), edits


def _repoint_to_body(problem: Problem) -> ProblemError:
    """Return what is wrong with a file, told by the fields of a revision: there is no form around them."""
    fields = [
        field.model_copy(update={"pointer": field.pointer.removeprefix("/metadata")}) for field in problem.errors or []
    ]
    return ProblemError.from_problem(problem.model_copy(update={"errors": fields or None}))
