"""Routes under /v1/identifications/batch: many identifications in one request, all or none."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from datetime import datetime
from functools import cache
from typing import TYPE_CHECKING

from fastapi import APIRouter, Response
from pydantic import Field, TypeAdapter

from dynident.errors import DynidentError
from dynident_service.identifications.routes import list_named_ids, new_identification
from dynident_service.identifications.wire_types import IdentificationRequest
from dynident_service.problems import (
    MOST_FIELDS,
    Problem,
    ProblemError,
    ProblemField,
    make_problem,
    make_unusable,
    to_problem,
)
from dynident_service.science_preload import hold_import_lock
from dynident_service.shared.required_resources import PrefetchedResources
from dynident_service.shared.resource_routes import RetryKeyDep, replay_response, resource_path
from dynident_service.shared.wire_types import LARGEST_BATCH, RequestModel, ViewModel
from dynident_service.storage.repository_values import NewResource, Resource, State
from dynident_service.storage_and_engine import Services, ServicesDep

if TYPE_CHECKING:
    from dynident.robot import Robot

router = APIRouter(prefix="/v1/identifications/batch", tags=["identifications"])
IDENTIFICATIONS = "identification_ids"
FIELDS_IN_SENTENCE = 3
"""So many wrong fields are told in the sentence; the others stand in the list alone."""


class BatchRequest(RequestModel):
    """Many identifications, each as in `POST /v1/identifications`: either all of them are accepted, or none."""

    items: list[IdentificationRequest] = Field(
        min_length=1, max_length=LARGEST_BATCH, description="At most DYNIDENT_MAX_BATCH"
    )


class BatchItem(ViewModel):
    """One identification of a batch."""

    id: str
    job_id: str
    status: State


class BatchView(ViewModel):
    """Identifications that were requested together."""

    id: str
    created_at: datetime
    states: dict[State, int] = Field(
        description="Number of identifications in each state; states without any are left out."
    )
    items: list[BatchItem] = Field(
        description="In the order of the request, without those that have been deleted since."
    )


@router.post("", status_code=202)
def create_identifications(
    body: BatchRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> BatchView:
    """Identify many models, each by its own job; if one of them cannot be accepted, none is."""
    key = retry.bind_to_body(body)
    existing = services.resources.find_retried(key)
    if existing is not None:
        return _show_batch(services, replay_response(existing, response))
    max_items = services.settings.max_batch
    if len(body.items) > max_items:
        raise make_unusable(
            f"{len(body.items)} are more than {max_items} (DYNIDENT_MAX_BATCH); send several batches", "/items"
        )
    request = {"count": len(body.items)}
    batch = services.resources.create_together(
        _accept_items(services, body),
        lambda ids: NewResource("batch", request, result={IDENTIFICATIONS: ids}, retry=key),
    )
    # After the transaction: the engine would find nothing before.
    services.engine.wake()
    response.headers["Location"] = resource_path(batch.kind, batch.id)
    return _show_batch(services, batch)


@router.get("/{batch_id}")
def get_batch(batch_id: str, services: ServicesDep) -> BatchView:
    """Show the identifications of a batch, and how many are in each state."""
    return _show_batch(services, services.resources.get("batch", batch_id))


@router.post("/{batch_id}/cancel")
def cancel_batch(batch_id: str, services: ServicesDep) -> BatchView:
    """Cancel all jobs of a batch that have not ended; a second request does no harm."""
    batch = services.resources.get("batch", batch_id)
    services.job_queue.cancel_jobs_of_resources(member_ids(batch))
    return _show_batch(services, batch)


@router.delete("/{batch_id}", status_code=204)
def delete_batch(batch_id: str, services: ServicesDep) -> None:
    """Delete a batch; its identifications stay."""
    services.resources.delete("batch", batch_id)


def _accept_items(services: Services, body: BatchRequest) -> list[NewResource]:
    """Return what is to be computed; raise a problem that names all that is wrong, with the place of each item."""
    with hold_import_lock():
        from dynident_service.robots.adapters import restore_robot

    identifiers = {identifier for item in body.items for identifier in list_named_ids(item)}
    # One query for all that the items name: a thousand items would otherwise ask one by one.
    ahead = PrefetchedResources(services.resources, identifiers)

    # Most batches are of one robot, which is restored once.
    @cache
    def load_robot(identifier: str) -> Robot:
        return restore_robot(ahead.get("robot", identifier).request)

    accepted: list[NewResource] = []
    wrong: list[Problem] = []
    for number, item in enumerate(body.items):
        try:
            accepted.append(
                _prefix_pointers(
                    new_identification(ahead, item, lambda resource: load_robot(resource.id)), f"/items/{number}"
                )
            )
        # All items are looked at, so that the user can mend everything at once.
        except (DynidentError, ProblemError) as error:
            problem = to_problem(error)
            wrong.append(problem.model_copy(update={"errors": _prefix_fields(problem, f"/items/{number}")}))
    if wrong:
        raise ProblemError.from_problem(_build_refusal(wrong, len(body.items)))
    return accepted


def _prefix_pointers(new: NewResource, place: str) -> NewResource:
    """Return the same, with the place of what it needs in the request of the whole batch."""
    return replace(new, rests_on=tuple(replace(need, pointer=place + need.pointer) for need in new.rests_on))


def _prefix_fields(problem: Problem, place: str) -> list[ProblemField]:
    fields = problem.errors or [ProblemField(pointer="", detail=problem.detail)]
    return [field.model_copy(update={"pointer": place + field.pointer}) for field in fields]


def _build_refusal(wrong: list[Problem], number: int) -> Problem:
    fields = [field for problem in wrong for field in problem.errors or []]
    first = "; ".join(f"{field.pointer}: {field.detail}" for field in fields[:FIELDS_IN_SENTENCE])
    detail = f"{len(wrong)} of {number} cannot be accepted, so none was accepted: {first}"
    more = f"; and {len(fields) - FIELDS_IN_SENTENCE} more" if len(fields) > FIELDS_IN_SENTENCE else ""
    return make_problem(422, detail + more, title=wrong[0].title, errors=fields[:MOST_FIELDS])


def member_ids(batch: Resource) -> list[str]:
    """Give the ids of the identifications of a stored batch."""
    return TypeAdapter(list[str]).validate_python((batch.result or {})[IDENTIFICATIONS])


def _show_batch(services: Services, batch: Resource) -> BatchView:
    ids = member_ids(batch)
    jobs = services.job_queue.find_jobs_of_resources(ids)
    # An identification that was deleted since has no job, and is left out.
    items = [
        BatchItem(id=identifier, job_id=jobs[identifier][0], status=jobs[identifier][1])
        for identifier in ids
        if identifier in jobs
    ]
    states = Counter(item.status for item in items)
    return BatchView(id=batch.id, created_at=batch.created_at, states=states, items=items)
