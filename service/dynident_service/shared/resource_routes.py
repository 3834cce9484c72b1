"""What the routes of all resources share: lists, labels, retries, tables, creation by a job.

Pages of lists have 50 items by default; a retry with the same idempotency key gets the first answer.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

from fastapi import Depends, Header, Query, Request, Response
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dynident_service.problems import ProblemError, make_unusable, make_validation_problem, to_problem_fields
from dynident_service.shared.wire_types import Computed, LabelsRequest, NamedRequest, Page, Table, to_plain_json
from dynident_service.storage.repository_values import Dependency, Kind, NewJob, NewResource, Resource, Retry
from dynident_service.storage_and_engine import Services, ServicesDep

ViewT = TypeVar("ViewT", bound=BaseModel)
BodyT = TypeVar("BodyT", bound=BaseModel)
ComputedT = TypeVar("ComputedT", bound=Computed[Any, Any])
PATHS: dict[str, str] = {
    "diagnosis": "diagnoses",
    "batch": "identifications/batch",
    **{kind: kind for kind in ("drive_gains", "current_models", "series")},
}
"""Below which path resources of a kind are, but for those that are below the kind's plural."""

Limit = Annotated[int, Query(ge=1, le=500, description="Largest number of items")]
Cursor = Annotated[str | None, Query(max_length=40, description="Cursor from the previous page")]


@dataclass(frozen=True)
class Pages:
    """The part of a list that is asked for, and whether it has what is archived."""

    services: Services
    limit: int
    cursor: str | None
    archived: bool = True

    def show(self, kind: Kind, show: Callable[[Resource], ViewT], on_id: str | None = None) -> Page[ViewT]:
        """Show this part of the list of a kind, or of those that depend on a resource."""
        page = self.services.resources.list_page(kind, self.limit, self.cursor, on_id, archived=self.archived)
        return Page(items=[show(resource) for resource in page.items], cursor=page.cursor)


# These dependencies are asynchronous because they are short: FastAPI runs synchronous ones in a thread each.


async def read_page_query(services: ServicesDep, limit: Limit = 50, cursor: Cursor = None) -> Pages:
    """Take the part of a list that is asked for."""
    return Pages(services, limit, cursor)


async def read_labelled_page_query(
    services: ServicesDep,
    limit: Limit = 50,
    cursor: Cursor = None,
    archived: Annotated[bool, Query(description="Whether to list archived resources, too")] = False,
) -> Pages:
    """Take the same of a list of resources that may be archived."""
    return Pages(services, limit, cursor, archived)


@dataclass(frozen=True)
class RetryKey:
    """The `Idempotency-Key` of a POST, if it carries one."""

    scope: str
    key: str | None

    def bind_to_body(self, body: BaseModel, *more: str) -> Retry | None:
        """Bind the key to a hash of the body, so that another request with the same key is recognised."""
        if self.key is None:
            return None
        # Sorted, so that the same request written in another order is the same request.
        content = json.dumps([body.model_dump(mode="json"), *more], sort_keys=True)
        return Retry(self.scope, self.key, hashlib.sha256(content.encode()).hexdigest())


async def read_retry_key(
    request: Request,
    idempotency_key: Annotated[
        str | None,
        Header(min_length=1, max_length=255, description="Makes a retry safe: the same key gives the same resource."),
    ] = None,
) -> RetryKey:
    """Take the key of a request."""
    # A key counts for one address: a client may use the same one for different requests.
    return RetryKey(f"{request.method} {request.url.path}", idempotency_key)


PagesDep = Annotated[Pages, Depends(read_page_query)]
LabelledPagesDep = Annotated[Pages, Depends(read_labelled_page_query)]
RetryKeyDep = Annotated[RetryKey, Depends(read_retry_key)]


def resource_path(kind: str, identifier: str) -> str:
    """Give the address of a resource."""
    return f"/v1/{PATHS.get(kind, f'{kind}s')}/{identifier}"


def create_or_replay(services: Services, new: NewResource, response: Response) -> Resource:
    """Store a resource and start its job, or return the one that an earlier try of the same request stored."""
    existing = services.resources.find_retried(new.retry)
    if existing is not None:
        return replay_response(existing, response)
    resource = services.resources.create(new)
    if new.job is not None:
        # The job need not wait for the engine's next look at the queue.
        services.engine.wake()
    response.headers["Location"] = resource_path(resource.kind, resource.id)
    return resource


def replay_response(existing: Resource, response: Response) -> Resource:
    """Answer a retry with what the first try made."""
    response.headers["Idempotency-Replayed"] = "true"
    response.headers["Location"] = resource_path(existing.kind, existing.id)
    return existing


def show_with_tables(
    view: type[ComputedT],
    services: Services,
    kind: Kind,
    identifier: str,
    build: Callable[[Services, Resource], list[Table]],
) -> ComputedT:
    """Show a resource that a job computes, with the tables of its result once there is one."""
    resource = services.resources.get(kind, identifier)
    return view.show(resource, tables=[] if resource.result is None else build(services, resource))


def update_labels(
    services: Services, kind: Kind, identifier: str, body: LabelsRequest, request: Mapping[str, object] | None = None
) -> Resource:
    """Change the labels of a resource, and these fields of its request."""
    return services.resources.update_labels(
        kind, identifier, name=body.name, tags=body.tags, archived=body.archived, request=request or {}
    )


@dataclass(frozen=True)
class Submission:
    """Stores what a request asks for with the job that computes it, or shows what an earlier try stored."""

    services: Services
    retry: RetryKey
    response: Response

    def __call__(
        self, view: type[ComputedT], kind: Kind, body: NamedRequest, job: NewJob, rests_on: Iterable[Dependency]
    ) -> ComputedT:
        """Store the resource of a body, and show it."""
        new = NewResource(
            kind,
            to_plain_json(body),
            name=body.name,
            rests_on=tuple(rests_on),
            job=job,
            retry=self.retry.bind_to_body(body),
        )
        return view.show(create_or_replay(self.services, new, self.response))


async def prepare_submission(services: ServicesDep, retry: RetryKeyDep, response: Response) -> Submission:
    """Take what storing a resource needs of a request besides its body."""
    return Submission(services, retry, response)


SubmissionDep = Annotated[Submission, Depends(prepare_submission)]


def require_succeeded(resource: Resource) -> Resource:
    """Return a resource that has been computed; raise a problem 409 with its state otherwise."""
    job = resource.job
    if job is not None and job.state != "succeeded":
        detail = (
            f"The {resource.kind} {resource.id} is {job.state}; this is available when its job {job.id} has succeeded."
        )
        raise ProblemError(409, detail, title="Not computed")
    return resource


def parse_json_body(kind: type[BodyT], text: str | bytes, pointer: str = "") -> BodyT:
    """Parse a body in JSON that is no body by itself, or stands beside others; `pointer` says where it stands."""
    try:
        # Also for the pointers of errors, which are told from what the body holds.
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise make_unusable(f"the {pointer[1:] or 'body'} is not JSON: {error}", pointer) from error
    try:
        # Validated as JSON, like every other body: of Python's objects pydantic accepts and refuses other types.
        return kind.model_validate_json(text)
    except ValidationError as error:
        errors: list[ErrorDetails] = [{**details, "loc": ("body", *details["loc"])} for details in error.errors()]
        raise ProblemError.from_problem(
            make_validation_problem(to_problem_fields(errors, document, pointer))
        ) from error
