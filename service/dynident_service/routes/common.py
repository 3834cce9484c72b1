"""What the routes share: queries of lists, idempotent retries, JSON bodies, resources and references to them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol, TypeVar

from fastapi import Depends, Header, Query, Request, Response
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from dynident_service.models.common import Computed, Page, Progress
from dynident_service.models.robots import JointView, RobotResult
from dynident_service.problems import (
    ProblemError,
    make_not_found,
    make_unusable,
    make_validation_problem,
    to_problem_fields,
)
from dynident_service.services import Services
from dynident_service.storage.records import Dependency, Kind, NewResource, Resource, Retry
from dynident_service.storage.resources import Resources


class ResourceReader(Protocol):
    """Reads resources by their ids."""

    def find(self, identifier: str) -> Resource | None:
        """Read a resource of whatever kind."""

    def get(self, kind: Kind, identifier: str) -> Resource:
        """Read one resource; a problem 404 if there is none."""


class HasResources(Protocol):
    """The part of the services that a check of a request needs: its resources."""

    @property
    def resources(self) -> ResourceReader:
        """The resources."""


class PrefetchedResources:
    """Resources that are read with one query, before a batch asks for them one by one."""

    def __init__(self, resources: Resources, identifiers: Iterable[str]) -> None:
        self._resources = resources
        self._found: dict[str, Resource | None] = dict(resources.find_all(identifiers))

    @property
    def resources(self) -> ResourceReader:
        """Itself, so that it can stand in for the services."""
        return self

    def find(self, identifier: str) -> Resource | None:
        """Give a resource, read now if it was not before."""
        if identifier not in self._found:
            self._found[identifier] = self._resources.find(identifier)
        return self._found[identifier]

    def get(self, kind: Kind, identifier: str) -> Resource:
        """Give a resource of a kind; a problem 404 if there is none."""
        resource = self.find(identifier)
        if resource is None or resource.kind != kind:
            raise make_not_found(kind, identifier)
        return resource


def require_resource(services: HasResources, kind: Kind, identifier: str, pointer: str) -> Resource:
    """Find a resource that the request names."""
    resource = services.resources.find(identifier)
    if resource is None or resource.kind != kind:
        raise make_unusable(f"there is no {kind} {identifier!r}", pointer, title="Unknown resource")
    return resource


def require_robot(services: HasResources, identifier: str) -> Resource:
    """Find the robot that the request names."""
    return require_resource(services, "robot", identifier, "/robot_id")


def require_result(
    services: HasResources, kind: Kind, identifier: str, pointer: str, title: str = "Unusable input"
) -> Resource:
    """Find a resource that the request names, and whose job must have succeeded."""
    resource = require_resource(services, kind, identifier, pointer)
    state = resource.job.state if resource.job is not None else "failed"
    if state != "succeeded":
        detail = f"the {kind} {identifier!r} is {state}; it must have succeeded"
        raise make_unusable(detail, pointer, title=title)
    return resource


def require_model(services: HasResources, identifier: str) -> Resource:
    """Find the identification that the request names; it must have succeeded."""
    return require_result(services, "identification", identifier, "/identification_id", "Not identified")


def require_design(services: HasResources, identifier: str, robot: Resource) -> Dependency:
    """Return the dependency on a design; it must be computed, and for this robot."""
    design = require_result(services, "design", identifier, "/design_id")
    if design.get_dependency("robot") != robot.id:
        detail = f"the design {identifier!r} is for another robot, {design.get_dependency('robot')}"
        raise make_unusable(detail, "/design_id")
    return Dependency(identifier, "design", "design", "/design_id")


def depend_on(resource: Resource) -> Dependency:
    """Return the dependency on a robot or a model that the request names by the id of its kind."""
    return Dependency(resource.id, resource.kind, resource.kind, f"/{resource.kind}_id")


def require_measurements(
    services: HasResources, robot: Resource, identifiers: Sequence[str], role: str, pointer: str
) -> tuple[Dependency, ...]:
    """Find the measurements that the request names; they must be of this robot, or of one with the same drives."""
    needs = []
    for index, identifier in enumerate(identifiers):
        item_pointer = f"{pointer}/{index}"
        measurement = require_resource(services, "measurement", identifier, item_pointer)
        if identifier in identifiers[:index]:
            raise make_unusable(f"the measurement {identifier!r} is given twice", item_pointer)
        require_same_drives(services, robot, measurement, item_pointer)
        needs.append(Dependency(identifier, "measurement", role, item_pointer))
    return tuple(needs)


def require_same_drives(services: HasResources, robot: Resource, measurement: Resource, pointer: str) -> None:
    """Refuse a measurement whose torques were computed with other drive gains, or of other joints."""
    own = measurement.get_dependency("robot")
    if own == robot.id:
        return
    other = services.resources.get("robot", own)
    # Measurements are stored as torques: they rest on the gains of the robot that they were uploaded for.
    if _list_drives(robot) != _list_drives(other):
        detail = (
            f"the measurement {measurement.id!r} is of the robot {other.name!r} ({own}), which has other joints or "
            f"drive gains; upload its file for the robot {robot.id}"
        )
        raise make_unusable(detail, pointer, title="Another robot's measurement")


def refuse_coupled(robot: Resource, reason: str) -> None:
    """Refuse a robot of which a motor acts on several joints."""
    coupled = [joint.name for joint in RobotResult.model_validate(robot.result).joints if joint.coupling]
    if coupled:
        raise make_unusable(
            f"the motors of {', '.join(coupled)} of this robot act on several joints; {reason} motors that act on "
            "one joint each",
            "/robot_id",
            title="Coupled drives",
        )


def _list_drives(robot: Resource) -> list[tuple[str, str, float | None, dict[str, float]]]:
    joints: list[JointView] = RobotResult.model_validate(robot.result).joints
    return [(joint.name, joint.type, joint.drive_gain, joint.coupling) for joint in joints]


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
    """Parse a body in JSON that is no body by itself, or stands beside others; `pointer` says where it stands.

    Raises
    ------
    ProblemError
        Where it is no JSON, or does not say what it has to.
    """
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
