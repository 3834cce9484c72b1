"""Reading of resources, each with its dependencies, its objects and its job.

A page takes three statements, as one resource does. They use SQLAlchemy's Core, as nearly every request needs them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, bindparam, select
from sqlalchemy.orm import Session

from dynident_service.storage.database import AT_ONCE
from dynident_service.storage.records import Job, OwnedObject, Resource
from dynident_service.storage.tables import DEPENDENCIES, JOBS, OBJECTS, RESOURCES

RESOURCE_COLUMNS = ("id", "kind", "name", "created_at", "request", "result", "tags", "archived")
JOB_COLUMNS = tuple(one.name for one in fields(Job))
WITH_JOBS: Select[Any] = select(
    *(RESOURCES.c[one] for one in RESOURCE_COLUMNS), *(JOBS.c[one] for one in JOB_COLUMNS)
).join(JOBS, JOBS.c.resource_id == RESOURCES.c.id, isouter=True)
"""Query for resources with their jobs; callers add conditions."""
IDS = "ids"
_NAMED: ColumnElement[Any] = bindparam(IDS, expanding=True)
_BY_IDS = WITH_JOBS.where(RESOURCES.c.id.in_(_NAMED))
_NEEDS = select(DEPENDENCIES.c.dependent_id, DEPENDENCIES.c.role, DEPENDENCIES.c.on_id).where(
    DEPENDENCIES.c.dependent_id.in_(_NAMED)
)
_OWNED = select(OBJECTS.c.resource_id, OBJECTS.c.role, OBJECTS.c.key, OBJECTS.c.size, OBJECTS.c.media_type).where(
    OBJECTS.c.resource_id.in_(_NAMED)
)


def read_resource(session: Session, identifier: str) -> Resource | None:
    """Return a resource of any kind, or None if there is none."""
    return next(iter(read_resources(session, (identifier,))), None)


def read_resources(session: Session, identifiers: Iterable[str]) -> tuple[Resource, ...]:
    """Return the resources of any kind with these ids, as far as they exist."""
    ids = sorted(set(identifiers))
    connection, resources = session.connection(), list[Resource]()
    for start in range(0, len(ids), AT_ONCE):
        rows = connection.execute(_BY_IDS, {IDS: ids[start : start + AT_ONCE]})
        resources += complete_resources(connection, rows.all())
    return tuple(resources)


def complete_resources(connection: Connection, rows: Sequence[Row[object]]) -> tuple[Resource, ...]:
    """Read dependencies and objects of resources.

    Parameters
    ----------
    connection : Connection
        Connection that reads.
    rows : sequence of Row
        Rows of `WITH_JOBS`.

    Returns
    -------
    tuple of Resource
        In the order of the rows.
    """
    # Two queries for all resources of a page, instead of two for each.
    by_id = {str(row[0]): row for row in rows}
    needs: dict[str, list[tuple[str, str]]] = {identifier: [] for identifier in by_id}
    objects: dict[str, dict[str, OwnedObject]] = {identifier: {} for identifier in by_id}
    if by_id:
        those = {IDS: list(by_id)}
        for dependent, role, on_id in connection.execute(_NEEDS, those):
            needs[dependent].append((role, on_id))
        for owner, role, key, size, media_type in connection.execute(_OWNED, those):
            objects[owner][role] = OwnedObject(role, key, size, media_type)
    return tuple(to_resource(row, needs[identifier], objects[identifier]) for identifier, row in by_id.items())


def to_resource(row: Sequence[object], needs: Iterable[tuple[str, str]], objects: dict[str, OwnedObject]) -> Resource:
    """Build a resource from its row of `WITH_JOBS`, its dependencies as (role, id), and its objects by role."""
    values: Sequence[Any] = row
    own, job = dict(zip(RESOURCE_COLUMNS, values, strict=False)), values[len(RESOURCE_COLUMNS) :]
    return Resource(
        **{**own, "tags": tuple(own["tags"] or ()), "archived": bool(own["archived"])},
        rests_on=tuple(sorted(needs)),
        objects=objects,
        # The outer join gives NULLs for a resource without a job.
        job=None if job[0] is None else Job(*job),
    )
