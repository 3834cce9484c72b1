"""Routes that all resources share: list, show, label, delete, and creation by a job."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import getdoc
from typing import Annotated, TypeVar, cast, get_type_hints

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel

from dynident_service.shared.paging_and_retries import (
    LabelledQueryDep,
    ListQueryDep,
    RetryKeyDep,
    create_or_replay,
    show_computed,
    show_page,
)
from dynident_service.shared.wire_types import Computed, LabelsRequest, Page, Table, to_plain_json
from dynident_service.storage.repository_values import Dependency, Kind, NewJob, NewResource, Resource
from dynident_service.storage_and_engine import Services, ServicesDep

BodyT = TypeVar("BodyT", bound=BaseModel)
Show = Callable[[Resource], BaseModel]
Needs = Callable[[Services, BodyT], Sequence[Dependency]]
Arguments = Callable[[Request, Mapping[str, object]], Mapping[str, object]]


@dataclass(frozen=True)
class ResourceRoutes:
    """A kind of resource, and what its routes are called and say in the contract.

    What is not given follows from the kind. Resources with a `label_description` may be archived.

    Parameters
    ----------
    kind : Kind
        The kind.
    view : type of BaseModel
        Model of the contract that shows a resource.
    parent_kind : Kind, optional
        Kind that each of them depends on, by which the list may be narrowed.
    show : callable, optional
        Shows a resource that no job computes.
    plural, singular : str
        Names in the operations.
    words : str
        Name of several of them in descriptions.
    list_description, show_description, delete_description, label_description : str
        Descriptions of the operations.
    tables : callable, optional
        Returns the figures of a computed resource as tables.
    changes : type of LabelsRequest
        The body that changes a stored resource.
    revise : callable, optional
        Returns the fields of the stored request that such a body changes, or refuses it.
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

    Parameters
    ----------
    router : APIRouter
        The router that gets the routes.
    routes : ResourceRoutes
        The kind of resource.
    job : NewJob
        The job that computes it.
    arguments : callable
        Makes further arguments of the job from the request and its body.

    Returns
    -------
    callable
        A decorator. The decorated function returns what the new resource depends on, or refuses the body. The route
        has its name and its docstring.
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
