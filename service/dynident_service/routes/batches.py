"""Batches: many identifications in one request, all of them accepted or none."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from typing import TYPE_CHECKING

from fastapi import APIRouter, Response
from pydantic import TypeAdapter

from dynident.errors import DynidentError
from dynident_service.models.identifications import BatchItem, BatchRequest, BatchView
from dynident_service.problems import (
    MOST_FIELDS,
    Problem,
    ProblemError,
    ProblemField,
    make_problem,
    problem_of,
    unusable,
)
from dynident_service.routes.common import RetryKeyDep, again, href
from dynident_service.routes.identifications import named_in, new_identification
from dynident_service.routes.needs import ReadAhead
from dynident_service.science import importing
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import NewResource, Resource

if TYPE_CHECKING:
    from dynident.robot import Robot

router = APIRouter(prefix="/v1/identifications/batch", tags=["identifications"])
IDENTIFICATIONS = "identification_ids"
FIRST = 3
"""So many wrong fields are told in the sentence; the others stand in the list alone."""


@router.post("", status_code=202)
def create_identifications(
    body: BatchRequest, services: ServicesDep, retry: RetryKeyDep, response: Response
) -> BatchView:
    """Identify many models, each by a job of its own; where one cannot be accepted, none is."""
    key = retry.of(body)
    existing = services.resources.known(key)
    if existing is not None:
        return _show(services, again(existing, response))
    max_items = services.settings.max_batch
    if len(body.items) > max_items:
        raise unusable(
            f"{len(body.items)} are more than {max_items} (DYNIDENT_MAX_BATCH); send several batches", "/items"
        )
    request = {"count": len(body.items)}
    batch = services.resources.create_together(
        _accepted(services, body),
        lambda ids: NewResource("batch", request, result={IDENTIFICATIONS: ids}, retry=key),
    )
    services.engine.nudge()
    response.headers["Location"] = href(batch.kind, batch.id)
    return _show(services, batch)


@router.get("/{batch_id}")
def get_batch(batch_id: str, services: ServicesDep) -> BatchView:
    """Show the identifications of a batch, and how many are in which state."""
    return _show(services, services.resources.get("batch", batch_id))


@router.post("/{batch_id}/cancel")
def cancel_batch(batch_id: str, services: ServicesDep) -> BatchView:
    """Stop all jobs of a batch that have not ended; asking twice does no harm."""
    batch = services.resources.get("batch", batch_id)
    services.ledger.cancel_of_resources(members(batch))
    return _show(services, batch)


@router.delete("/{batch_id}", status_code=204)
def delete_batch(batch_id: str, services: ServicesDep) -> None:
    """Forget what was asked for together; the identifications stay."""
    services.resources.delete("batch", batch_id)


def _accepted(services: Services, body: BatchRequest) -> list[NewResource]:
    """What is to be computed; a problem that names all that is wrong, with the place of each item."""
    with importing():
        from dynident_service.adapters.robots import robot_of

    identifiers = {identifier for item in body.items for identifier in named_in(item)}
    ahead = ReadAhead(services.resources, identifiers)

    @cache
    def robot(identifier: str) -> Robot:
        return robot_of(ahead.get("robot", identifier).request)

    accepted: list[NewResource] = []
    wrong: list[Problem] = []
    for number, item in enumerate(body.items):
        try:
            accepted.append(
                _placed(new_identification(ahead, item, lambda resource: robot(resource.id)), f"/items/{number}")
            )
        except (DynidentError, ProblemError) as error:
            problem = problem_of(error)
            wrong.append(problem.model_copy(update={"errors": _fields(problem, f"/items/{number}")}))
    if wrong:
        raise ProblemError.of(_refusal(wrong, len(body.items)))
    return accepted


def _placed(new: NewResource, place: str) -> NewResource:
    """The same, with the place of what it needs in the request of the whole batch."""
    return replace(new, rests_on=tuple(replace(need, pointer=place + need.pointer) for need in new.rests_on))


def _fields(problem: Problem, place: str) -> list[ProblemField]:
    fields = problem.errors or [ProblemField(pointer="", detail=problem.detail)]
    return [field.model_copy(update={"pointer": place + field.pointer}) for field in fields]


def _refusal(wrong: list[Problem], number: int) -> Problem:
    fields = [field for problem in wrong for field in problem.errors or []]
    first = "; ".join(f"{field.pointer}: {field.detail}" for field in fields[:FIRST])
    detail = f"{len(wrong)} of {number} cannot be accepted, so none was: {first}"
    more = f"; and {len(fields) - FIRST} more" if len(fields) > FIRST else ""
    return make_problem(422, detail + more, title=wrong[0].title, errors=fields[:MOST_FIELDS])


def members(batch: Resource) -> list[str]:
    """Give the ids of the identifications of a stored batch."""
    return TypeAdapter(list[str]).validate_python((batch.result or {})[IDENTIFICATIONS])


def _show(services: Services, batch: Resource) -> BatchView:
    ids = members(batch)
    jobs = services.ledger.of_resources(ids)
    items = [
        BatchItem(id=identifier, job_id=jobs[identifier][0], status=jobs[identifier][1])
        for identifier in ids
        if identifier in jobs
    ]
    states = Counter(item.status for item in items)
    return BatchView(id=batch.id, created_at=batch.created_at, states=states, items=items)
