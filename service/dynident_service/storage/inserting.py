"""Resources as they are stored: each with what it rests on, its objects, its job and its retry key, or nothing at all.

Table by table, by SQLAlchemy's Core: as many statements for a thousand as for one, nearly. What was stored is known
without being read again.
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
    """Insert a resource of an owner within a transaction; the caller commits."""
    (made,) = insert_all(session, objects, [new], owner)
    return made


def insert_all(
    session: Session, objects: ObjectStore, several: Sequence[NewResource], owner: str | None
) -> list[Resource]:
    """Insert resources of an owner within a transaction; the caller commits.

    Raises ProblemError where one rests on what is not there, ObjectGone where one owns what is not there.
    """
    connection = session.connection()
    _require(connection, [need for new in several for need in new.rests_on])
    moment = clock(session)
    made = [_resource(new, moment) for new in several]
    pairs = list(zip(made, several, strict=True))
    _insert(connection, RESOURCES, [{**_row(one), "owner": owner} for one in made])
    rest(session, [(one.id, on_id, role) for one in made for role, on_id in one.rests_on])
    own(session, objects, [(one.id, owned) for one in made for owned in one.objects.values()])
    _insert(connection, RETRIES, [_key(one, new.retry) for one, new in pairs if new.retry is not None])
    jobs = add_jobs(session, [(new.job, one.id) for one, new in pairs if new.job is not None], moment, owner)
    job_of = {job.resource_id: job for job in jobs}
    return [replace(one, job=job_of.get(one.id)) for one in made]


def rest(session: Session, several: Iterable[tuple[str, str, str]]) -> None:
    """Record that resources rest on others: (dependent, on, role) each."""
    rows = [{"dependent_id": dependent, "on_id": on_id, "role": role} for dependent, on_id, role in several]
    _insert(session.connection(), DEPENDENCIES, rows)


def own(session: Session, objects: ObjectStore, several: Sequence[tuple[str, Owned]]) -> None:
    """Record the objects that resources own; raises ObjectGone if one is not there."""
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
        rests_on=tuple(sorted({(one.role, one.id) for one in new.rests_on})),
        objects={one.role: one for one in new.objects},
        job=None,
    )


def _row(made: Resource) -> Row:
    names = ("id", "kind", "name", "created_at", "request", "result")
    return {**{name: getattr(made, name) for name in names}, "tags": list(made.tags), "archived": made.archived}


def _key(made: Resource, retry: Retry) -> Row:
    return {**vars(retry), "resource_id": made.id, "created_at": made.created_at}


def _insert(connection: Connection, table: Table, rows: Sequence[Row]) -> None:
    if rows:
        connection.execute(_INSERTING[table], rows)


def _require(connection: Connection, needs: Sequence[RestsOn]) -> None:
    ids = sorted({need.id for need in needs})
    kinds: dict[str, str] = {}
    for start in range(0, len(ids), AT_ONCE):
        found = connection.execute(_KINDS, {IDS: ids[start : start + AT_ONCE]})
        kinds |= {identifier: kind for identifier, kind in found}  # noqa: C416
    for need in needs:
        if kinds.get(need.id) != need.kind:
            raise unusable(f"there is no {need.kind} {need.id!r}", need.pointer, title="Unknown resource")
