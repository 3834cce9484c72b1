"""Routes that all resources share: list, show, label, delete, creation by a job.

Pages of lists have 50 items by default; a retry with the same idempotency key gets the first answer.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import getdoc
from typing import Annotated, Any, TypeVar, cast, get_type_hints

from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dynident_service.problems import ProblemError, make_unusable, make_validation_problem, to_problem_fields
from dynident_service.shared.wire_types import Computed, LabelsRequest, Page, Progress, Table, to_plain_json
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
class ListQuery:
    """`limit` and `cursor` of a list, and whether it has what is archived."""

    limit: int
    cursor: str | None
    archived: bool = True


# These dependencies are asynchronous because they are short: FastAPI runs synchronous ones in a thread each.


async def read_list_query(limit: Limit = 50, cursor: Cursor = None) -> ListQuery:
    """Take the part of a list that is asked for."""
    return ListQuery(limit, cursor)


async def read_labelled_list_query(
    limit: Limit = 50,
    cursor: Cursor = None,
    archived: Annotated[bool, Query(description="Whether to list archived resources, too")] = False,
) -> ListQuery:
    """Take the same of a list of resources that may be archived."""
    return ListQuery(limit, cursor, archived)


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


ListQueryDep = Annotated[ListQuery, Depends(read_list_query)]
LabelledQueryDep = Annotated[ListQuery, Depends(read_labelled_list_query)]
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


def show_computed(view: type[ComputedT], resource: Resource, **more: object) -> ComputedT:
    """Show a resource that a job computes."""
    job = resource.job
    assert job is not None
    job_fields = {
        "job_id": job.id,
        "status": job.state,
        "progress": Progress(fraction=job.fraction, message=job.message),
        "error": job.error,
    }
    return view.model_validate({**vars(resource), **job_fields, **more})


def show_page(
    services: Services, kind: Kind, query: ListQuery, show: Callable[[Resource], ViewT], on_id: str | None = None
) -> Page[ViewT]:
    """Show a part of the list of a kind."""
    page = services.resources.list_page(kind, query.limit, query.cursor, on_id, archived=query.archived)
    return Page(items=[show(resource) for resource in page.items], cursor=page.cursor)


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


Show = Callable[[Resource], BaseModel]
Needs = Callable[[Services, BodyT], Sequence[Dependency]]
Arguments = Callable[[Request, Mapping[str, object]], Mapping[str, object]]


@dataclass(frozen=True)
class ResourceRoutes:
    """A kind of resource, and what its routes are called and say in the contract.

    What is not given follows from the kind. Resources with a `label_description` may be archived. `parent_kind` narrows
    the list, `show` shows a resource that no job computes, `tables` returns its figures as tables, and `revise` the
    fields of the stored request that a body of `changes` changes.
    """

    kind: Kind
    view: type[BaseModel]
    parent_kind: Kind | None = None
    show: Show | None = None
    plural: str = ""
    singular: str = ""
    words: str = ""
    list_description: str = ""
    show_description: str = ""
    delete_description: str = ""
    label_description: str = ""
    tables: Callable[[Services, Resource], list[Table]] | None = None
    changes: type[LabelsRequest] = LabelsRequest
    revise: Callable[[Resource, LabelsRequest], Mapping[str, object]] | None = None


SHOW_FUNCTIONS: dict[Kind, Show] = {}
"""The function that shows a resource, by kind."""


def add_resource_routes(router: APIRouter, routes: ResourceRoutes, *, with_list: bool = True) -> None:
    """Add the routes of a kind of resource; `with_list=False` where its list is a route of its own."""
    kind, show = routes.kind, routes.show or _show_by_job(routes.view)
    SHOW_FUNCTIONS[kind] = show

    def show_one(identifier: str, services: ServicesDep) -> object:
        resource = services.resources.get(kind, identifier)
        if routes.tables is None or resource.result is None:
            return show(resource)
        assert issubclass(routes.view, Computed)
        return show_computed(routes.view, resource, tables=routes.tables(services, resource))

    def delete_one(identifier: str, services: ServicesDep) -> None:
        services.resources.delete(kind, identifier)

    def label_one(identifier: str, body: LabelsRequest, services: ServicesDep) -> object:
        revised = {} if routes.revise is None else routes.revise(services.resources.get(kind, identifier), body)
        return show(
            services.resources.update_labels(
                kind, identifier, name=body.name, tags=body.tags, archived=body.archived, request=revised
            )
        )

    # FastAPI reads annotations: they name the parameter after the kind, and the model that is returned.
    for route in (show_one, delete_one, label_one):
        route.__annotations__["identifier"] = Annotated[str, Path(alias=f"{kind}_id")]
    label_one.__annotations__["body"] = routes.changes
    show_one.__annotations__["return"] = label_one.__annotations__["return"] = routes.view
    path, singular = f"/{{{kind}_id}}", routes.singular or kind
    if with_list:
        _add_list_route(router, routes, show)
    to_show = routes.show_description or f"Show a {kind}, with its result once there is one."
    router.get(path, name=f"get_{singular}", description=to_show)(show_one)
    router.delete(
        path, status_code=204, name=f"delete_{singular}", description=routes.delete_description or f"Delete a {kind}."
    )(delete_one)
    if routes.label_description:
        router.patch(path, name=f"label_{singular}", description=routes.label_description)(label_one)


def add_create_route(
    router: APIRouter, routes: ResourceRoutes, job: NewJob, arguments: Arguments = lambda _, __: {}
) -> Callable[[Needs[BodyT]], Needs[BodyT]]:
    """Decorate a function that checks a body: add the route that creates a resource by a job, and the other routes.

    The decorated function returns what the new resource depends on, or refuses the body. The route has its name and
    docstring. `arguments` makes further arguments of the job.
    """
    add_resource_routes(router, routes)

    def register_route(needs: Needs[BodyT]) -> Needs[BodyT]:
        def create_resource(
            body: BodyT, services: ServicesDep, retry: RetryKeyDep, request: Request, response: Response
        ) -> object:
            rests_on, request_body = tuple(needs(services, body)), to_plain_json(body)
            to_do = replace(job, arguments=arguments(request, request_body))
            name = cast(str | None, request_body["name"])
            new = NewResource(
                routes.kind, request_body, name=name, rests_on=rests_on, job=to_do, retry=retry.bind_to_body(body)
            )
            return SHOW_FUNCTIONS[routes.kind](create_or_replay(services, new, response))

        # FastAPI reads the models of body and answer from the annotations; they differ from kind to kind.
        create_resource.__annotations__ |= {"body": get_type_hints(needs)["body"], "return": routes.view}
        router.post("", status_code=202, name=needs.__name__, description=getdoc(needs))(create_resource)
        return needs

    return register_route


def _add_list_route(router: APIRouter, routes: ResourceRoutes, show: Show) -> None:
    def list_of_parent(services: ServicesDep, query: ListQueryDep, on_id: str | None = None) -> object:
        return show_page(services, routes.kind, query, show, on_id)

    def list_all(services: ServicesDep, query: ListQueryDep) -> object:
        return show_page(services, routes.kind, query, show)

    # Two functions, since FastAPI takes every parameter of a function for one of the query.
    route: Callable[..., object] = list_of_parent if routes.parent_kind else list_all
    if routes.parent_kind:
        route.__annotations__["on_id"] = Annotated[str | None, Query(alias=f"{routes.parent_kind}_id")]
    # Only kinds that have labels can be narrowed down by them.
    if routes.label_description:
        route.__annotations__["query"] = LabelledQueryDep
    route.__annotations__["return"] = Page.__class_getitem__(routes.view)
    several = routes.plural or f"{routes.kind}s"
    of_one = f"; those of one {routes.parent_kind} if requested" if routes.parent_kind else ""
    to_list = routes.list_description or f"List the {routes.words or several}, newest first{of_one}."
    router.get("", name=f"list_{several}", description=to_list)(route)


def _show_by_job(view: type[BaseModel]) -> Show:
    assert issubclass(view, Computed)
    return lambda resource: show_computed(view, resource)
