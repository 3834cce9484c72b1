"""Resources as they are read: each with what it rests on, the objects that it owns and its job.

Three statements for a page of them as for one, by SQLAlchemy's Core: these are on the way of every request.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, select
from sqlalchemy.orm import Session

from dynident_service.storage.database import AT_ONCE
from dynident_service.storage.records import Job, Owned, Resource
from dynident_service.storage.tables import DEPENDENCIES, JOBS, OBJECTS, RESOURCES

OF_RESOURCES = ("id", "kind", "name", "created_at", "request", "result", "tags", "archived")
OF_JOBS = tuple(one.name for one in fields(Job))
WITH_JOBS: Select[Any] = select(*(RESOURCES.c[one] for one in OF_RESOURCES), *(JOBS.c[one] for one in OF_JOBS)).join(
    JOBS, JOBS.c.resource_id == RESOURCES.c.id, isouter=True
)
"""Resources, each with its job; to be narrowed by who asks."""
IDS = "ids"
_NAMED: ColumnElement[Any] = bindparam(IDS, expanding=True)
_BY_IDS = WITH_JOBS.where(RESOURCES.c.id.in_(_NAMED))
_NEEDS = select(DEPENDENCIES.c.dependent_id, DEPENDENCIES.c.role, DEPENDENCIES.c.on_id).where(
    DEPENDENCIES.c.dependent_id.in_(_NAMED)
)
_OWNED = select(OBJECTS.c.resource_id, OBJECTS.c.role, OBJECTS.c.key, OBJECTS.c.size, OBJECTS.c.media_type).where(
    OBJECTS.c.resource_id.in_(_NAMED)
)


def read(session: Session, identifier: str) -> Resource | None:
    """Read a resource of whatever kind."""
    return next(iter(read_those(session, (identifier,))), None)


def read_those(session: Session, identifiers: Iterable[str]) -> tuple[Resource, ...]:
    """Read resources of whatever kind by their ids, of those that are there."""
    ids = sorted(set(identifiers))
    connection, found = session.connection(), list[Resource]()
    for start in range(0, len(ids), AT_ONCE):
        rows = connection.execute(_BY_IDS, {IDS: ids[start : start + AT_ONCE]})
        found += complete(connection, rows.all())
    return tuple(found)


def complete(connection: Connection, rows: Sequence[Row[object]]) -> tuple[Resource, ...]:
    """Read what belongs to resources, whose rows are those of `WITH_JOBS`, in their order."""
    by_id = {str(row[0]): row for row in rows}
    needs: dict[str, list[tuple[str, str]]] = {one: [] for one in by_id}
    objects: dict[str, dict[str, Owned]] = {one: {} for one in by_id}
    if by_id:
        those = {IDS: list(by_id)}
        for dependent, role, on_id in connection.execute(_NEEDS, those):
            needs[dependent].append((role, on_id))
        for owner, role, key, size, media_type in connection.execute(_OWNED, those):
            objects[owner][role] = Owned(role, key, size, media_type)
    return tuple(as_resource(row, needs[one], objects[one]) for one, row in by_id.items())


def as_resource(row: Sequence[object], needs: Iterable[tuple[str, str]], objects: dict[str, Owned]) -> Resource:
    """A resource as its row of `WITH_JOBS` says, with what it rests on and owns."""
    values: Sequence[Any] = row
    own, job = dict(zip(OF_RESOURCES, values, strict=False)), values[len(OF_RESOURCES) :]
    return Resource(
        **{**own, "tags": tuple(own["tags"] or ()), "archived": bool(own["archived"])},
        rests_on=tuple(sorted(needs)),
        objects=objects,
        job=None if job[0] is None else Job(*job),
    )
