"""The routes that all kinds of resources share: create by a job, list, show, label, delete."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from inspect import getdoc
from typing import Annotated, TypeVar, cast, get_type_hints

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel

from dynident_service.models.common import Computed, LabelsRequest, Page, plain
from dynident_service.models.tables import Table
from dynident_service.routes.common import LabelledQueryDep, ListQueryDep, RetryKeyDep, computed, make, page_of
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import Kind, NewJob, NewResource, Resource, RestsOn

BodyT = TypeVar("BodyT", bound=BaseModel)
Show = Callable[[Resource], BaseModel]
Needs = Callable[[Services, BodyT], Sequence[RestsOn]]
Arguments = Callable[[Request, Mapping[str, object]], Mapping[str, object]]


@dataclass(frozen=True)
class Kept:
    """A kind of resource, and what its routes are called and say in the contract.

    `show` tells how one is shown that no job computes; `of` is the kind that each of them rests on, whose list may be
    asked for, if there is one. `several` and `one` are in the names of the operations, `listed`, `words`, `shown`,
    `deleted` and `labelled` in their descriptions: what is not given follows from the kind. Those that may be
    `labelled` may be archived. `tables` has the figures of one that was computed as tables, if it can be shown so.
    """

    kind: Kind
    view: type[BaseModel]
    of: Kind | None = None
    show: Show | None = None
    several: str = ""
    one: str = ""
    words: str = ""
    listed: str = ""
    shown: str = ""
    deleted: str = ""
    labelled: str = ""
    tables: Callable[[Services, Resource], list[Table]] | None = None


SHOWN: dict[Kind, Show] = {}
"""The function that shows a resource, by kind."""


def keep(router: APIRouter, routes: Kept, *, with_list: bool = True) -> None:
    """Add the routes of a kind of resource; `with_list=False` where its list is a route of its own."""
    kind, show = routes.kind, routes.show or _computed(routes.view)
    SHOWN[kind] = show

    def shown(identifier: str, services: ServicesDep) -> object:
        resource = services.resources.get(kind, identifier)
        if routes.tables is None or resource.result is None:
            return show(resource)
        assert issubclass(routes.view, Computed)
        return computed(routes.view, resource, tables=routes.tables(services, resource))

    def deleted(identifier: str, services: ServicesDep) -> None:
        services.resources.delete(kind, identifier)

    def labelled(identifier: str, body: LabelsRequest, services: ServicesDep) -> object:
        return show(services.resources.label(kind, identifier, name=body.name, tags=body.tags, archived=body.archived))

    # FastAPI reads annotations: they name the parameter after the kind, and the model that is returned.
    for route in (shown, deleted, labelled):
        route.__annotations__["identifier"] = Annotated[str, Path(alias=f"{kind}_id")]
    shown.__annotations__["return"] = labelled.__annotations__["return"] = routes.view
    path, singular = f"/{{{kind}_id}}", routes.one or kind
    if with_list:
        _keep_list(router, routes, show)
    to_show = routes.shown or f"Show a {kind}, with its result once there is one."
    router.get(path, name=f"get_{singular}", description=to_show)(shown)
    router.delete(path, status_code=204, name=f"delete_{singular}", description=routes.deleted or f"Delete a {kind}.")(
        deleted
    )
    if routes.labelled:
        router.patch(path, name=f"label_{singular}", description=routes.labelled)(labelled)


def asked_for(
    router: APIRouter, routes: Kept, job: NewJob, arguments: Arguments = lambda _, __: {}
) -> Callable[[Needs[BodyT]], Needs[BodyT]]:
    """Decorate a function that checks a body: add the route that creates a resource by a job, and the other routes.

    Parameters
    ----------
    router : APIRouter
        The router that gets the routes.
    routes : Kept
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
    keep(router, routes)

    def asked(needs: Needs[BodyT]) -> Needs[BodyT]:
        def created(
            body: BodyT, services: ServicesDep, retry: RetryKeyDep, request: Request, response: Response
        ) -> object:
            rests_on, request_body = tuple(needs(services, body)), plain(body)
            to_do = replace(job, arguments=arguments(request, request_body))
            name = cast(str | None, request_body["name"])
            new = NewResource(routes.kind, request_body, name=name, rests_on=rests_on, job=to_do, retry=retry.of(body))
            return SHOWN[routes.kind](make(services, new, response))

        created.__annotations__ |= {"body": get_type_hints(needs)["body"], "return": routes.view}
        router.post("", status_code=202, name=needs.__name__, description=getdoc(needs))(created)
        return needs

    return asked


def _keep_list(router: APIRouter, routes: Kept, show: Show) -> None:
    def listed(services: ServicesDep, query: ListQueryDep, on_id: str | None = None) -> object:
        return page_of(services, routes.kind, query, show, on_id)

    def listed_all(services: ServicesDep, query: ListQueryDep) -> object:
        return page_of(services, routes.kind, query, show)

    route: Callable[..., object] = listed if routes.of else listed_all
    if routes.of:
        route.__annotations__["on_id"] = Annotated[str | None, Query(alias=f"{routes.of}_id")]
    if routes.labelled:
        route.__annotations__["query"] = LabelledQueryDep
    route.__annotations__["return"] = Page.__class_getitem__(routes.view)
    several = routes.several or f"{routes.kind}s"
    of_one = f"; those of one {routes.of} if asked" if routes.of else ""
    to_list = routes.listed or f"List the {routes.words or several}, newest first{of_one}."
    router.get("", name=f"list_{several}", description=to_list)(route)


def _computed(view: type[BaseModel]) -> Show:
    assert issubclass(view, Computed)
    return lambda resource: computed(view, resource)
