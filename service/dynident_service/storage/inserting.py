"""Insertion of resources with their dependencies, objects, job and retry key, all or nothing.

Written table by table with SQLAlchemy's Core: a thousand resources take hardly more statements than one, and the
stored resources are known without being read again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Table, bindparam, insert, select
from sqlalchemy.orm import Session

from dynident_service.problems import unusable
from dynident_service.storage.database import AT_ONCE, clock
from dynident_service.storage.identifiers import new_identifier
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.records import NewResource, Owned, Resource, RestsOn, Retry
from dynident_service.storage.tables import DEPENDENCIES, OBJECTS, RESOURCES, RETRIES
from dynident_service.storage.tombstones import hold
from dynident_service.storage.turns import add_jobs

IDS = "ids"
Row = dict[str, Any]
_KINDS = (
    select(RESOURCES.c.id, RESOURCES.c.kind)
    .where(RESOURCES.c.id.in_(bindparam(IDS, expanding=True)))
    # The share lock keeps the needed resources from being deleted before this transaction ends.
    .with_for_update(read=True)
)
_INSERTING = {table: insert(table) for table in (RESOURCES, DEPENDENCIES, OBJECTS, RETRIES)}


def insert_one(session: Session, objects: ObjectStore, new: NewResource, owner: str | None) -> Resource:
    """Insert one resource within a transaction; the caller commits.

    Parameters
    ----------
    session : Session
        Session that writes.
    objects : ObjectStore
        Store with the objects that the resource owns.
    new : NewResource
        What to insert.
    owner : str or None
        Name of the API key that it belongs to.

    Returns
    -------
    Resource
        As stored.
    """
    (resource,) = insert_all(session, objects, [new], owner)
    return resource


def insert_all(
    session: Session, objects: ObjectStore, several: Sequence[NewResource], owner: str | None
) -> list[Resource]:
    """Insert several resources of one owner within a transaction; the caller commits.

    Parameters
    ----------
    session : Session
        Session that writes.
    objects : ObjectStore
        Store with the objects that the resources own.
    several : sequence of NewResource
        What to insert.
    owner : str or None
        Name of the API key that they belong to.

    Returns
    -------
    list of Resource
        As stored, in the same order.

    Raises
    ------
    ProblemError
        If a resource that one depends on does not exist.
    ObjectGone
        If an object that one owns does not exist.
    """
    connection = session.connection()
    _require(connection, [need for new in several for need in new.rests_on])
    # One time for all of them: a batch sorts as a whole.
    moment = clock(session)
    resources = [_resource(new, moment) for new in several]
    pairs = list(zip(resources, several, strict=True))
    _insert(connection, RESOURCES, [{**_row(resource), "owner": owner} for resource in resources])
    rest(session, [(resource.id, on_id, role) for resource in resources for role, on_id in resource.rests_on])
    own(session, objects, [(resource.id, owned) for resource in resources for owned in resource.objects.values()])
    _insert(connection, RETRIES, [_key(resource, new.retry) for resource, new in pairs if new.retry is not None])
    jobs = add_jobs(session, [(new.job, resource.id) for resource, new in pairs if new.job is not None], moment, owner)
    job_of = {job.resource_id: job for job in jobs}
    return [replace(resource, job=job_of.get(resource.id)) for resource in resources]


def rest(session: Session, several: Iterable[tuple[str, str, str]]) -> None:
    """Insert dependencies between resources, each as (dependent, needed, role)."""
    rows = [{"dependent_id": dependent, "on_id": on_id, "role": role} for dependent, on_id, role in several]
    _insert(session.connection(), DEPENDENCIES, rows)


def own(session: Session, objects: ObjectStore, several: Sequence[tuple[str, Owned]]) -> None:
    """Insert the ownership of objects; raise ObjectGone if one is not in the store."""
    hold(session, objects, (owned for _, owned in several))
    _insert(
        session.connection(), OBJECTS, [{"resource_id": identifier, **vars(owned)} for identifier, owned in several]
    )


def _resource(new: NewResource, moment: datetime) -> Resource:
    return Resource(
        id=new_identifier(new.kind),
        kind=new.kind,
        name=new.name,
        created_at=moment,
        request=dict(new.request),
        result=None if new.result is None else dict(new.result),
        rests_on=tuple(sorted({(need.role, need.id) for need in new.rests_on})),
        objects={owned.role: owned for owned in new.objects},
        job=None,
    )


def _row(resource: Resource) -> Row:
    names = ("id", "kind", "name", "created_at", "request", "result")
    return {
        **{name: getattr(resource, name) for name in names},
        "tags": list(resource.tags),
        "archived": resource.archived,
    }


def _key(resource: Resource, retry: Retry) -> Row:
    return {**vars(retry), "resource_id": resource.id, "created_at": resource.created_at}


def _insert(connection: Connection, table: Table, rows: Sequence[Row]) -> None:
    if rows:
        connection.execute(_INSERTING[table], rows)


def _require(connection: Connection, needs: Sequence[RestsOn]) -> None:
    ids = sorted({need.id for need in needs})
    kinds: dict[str, str] = {}
    for start in range(0, len(ids), AT_ONCE):
        rows = connection.execute(_KINDS, {IDS: ids[start : start + AT_ONCE]})
        kinds |= {identifier: kind for identifier, kind in rows}  # noqa: C416
    for need in needs:
        if kinds.get(need.id) != need.kind:
            raise unusable(f"there is no {need.kind} {need.id!r}", need.pointer, title="Unknown resource")
