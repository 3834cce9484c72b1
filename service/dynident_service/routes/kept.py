"""The routes that all resources which a job computes have: listed, shown, deleted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import APIRouter, Path, Query

from dynident_service.models.common import Computed, Page
from dynident_service.models.tables import Table
from dynident_service.routes.common import ListQueryDep, computed, page_of
from dynident_service.services import Services, ServicesDep
from dynident_service.storage.records import Kind, Resource


@dataclass(frozen=True)
class Kept:
    """A kind of resource, and what its routes are called and say in the contract.

    `of` is the kind that each of them rests on, and its list may be asked for; `several` and `one` are in the names of
    the operations, `words`, `shown` and `deleted` in their descriptions: what is not given follows from the kind.
    `tables` has the figures of one that was computed as tables, if it can be shown so.
    """

    kind: Kind
    view: type[Computed[Any, Any]]
    of: Kind
    several: str = ""
    one: str = ""
    words: str = ""
    shown: str = ""
    deleted: str = ""
    tables: Callable[[Services, Resource], list[Table]] | None = None


VIEWS: dict[Kind, type[Computed[Any, Any]]] = {}
"""How each kind that has these routes is shown."""


def keep(router: APIRouter, kept: Kept) -> None:
    """Add the three routes of a kind."""
    VIEWS[kept.kind] = kept.view

    def listed(services: ServicesDep, query: ListQueryDep, on_id: str | None = None) -> object:
        return page_of(services, kept.kind, query, lambda one: computed(kept.view, one), on_id)

    def shown(identifier: str, services: ServicesDep) -> object:
        found = services.resources.get(kept.kind, identifier)
        tabled = {} if kept.tables is None or found.result is None else {"tables": kept.tables(services, found)}
        return computed(kept.view, found, **tabled)

    def deleted(identifier: str, services: ServicesDep) -> None:
        services.resources.delete(kept.kind, identifier)

    # Parameters are called after the kinds.
    named = Annotated[str, Path(alias=f"{kept.kind}_id")]
    shown.__annotations__["identifier"] = deleted.__annotations__["identifier"] = named
    listed.__annotations__["on_id"] = Annotated[str | None, Query(alias=f"{kept.of}_id")]
    listed.__annotations__["return"] = Page.__class_getitem__(kept.view)
    shown.__annotations__["return"] = kept.view
    at = f"/{{{kept.kind}_id}}"
    several, one = kept.several or f"{kept.kind}s", kept.one or kept.kind
    to_list = f"List the {kept.words or several}, newest first; those of one {kept.of} if asked."
    to_show = kept.shown or f"Show a {kept.kind}, with its result once there is one."
    router.get("", name=f"list_{several}", description=to_list)(listed)
    router.get(at, name=f"get_{one}", description=to_show)(shown)
    to_delete = kept.deleted or f"Delete a {kept.kind}."
    router.delete(at, status_code=204, name=f"delete_{one}", description=to_delete)(deleted)
