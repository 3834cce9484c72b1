"""SQL that reads and inserts rows of resources with dependencies, objects, jobs and retry keys.

Called by `resource_repository`; the tables are in `database_tables`.

Written and read table by table with SQLAlchemy's Core, as nearly every request needs them: a thousand resources take
hardly more statements than one, and the stored resources are known without being read again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import fields, replace
from datetime import datetime
from typing import Any

from sqlalchemy import ColumnElement, Connection, Row, Select, Table, bindparam, insert, select
from sqlalchemy.orm import Session

from dynident_service.problems import make_unusable
from dynident_service.storage.database import AT_ONCE, get_database_time
from dynident_service.storage.database_tables import DEPENDENCIES, JOBS, OBJECTS, RESOURCES, RETRIES
from dynident_service.storage.deletion_and_expiry import lock_objects
from dynident_service.storage.job_transitions import add_jobs
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import (
    Dependency,
    Job,
    NewResource,
    OwnedObject,
    Resource,
    Retry,
    create_identifier,
)

RESOURCE_COLUMNS = ("id", "kind", "name", "created_at", "request", "result", "tags", "archived")
JOB_COLUMNS = tuple(field.name for field in fields(Job))
WITH_JOBS: Select[Any] = select(
    *(RESOURCES.c[name] for name in RESOURCE_COLUMNS), *(JOBS.c[name] for name in JOB_COLUMNS)
).join(JOBS, JOBS.c.resource_id == RESOURCES.c.id, isouter=True)
"""Query for resources with their jobs; callers add conditions."""
_IDS = "ids"
_NAMED: ColumnElement[Any] = bindparam(_IDS, expanding=True)
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
        rows = connection.execute(_BY_IDS, {_IDS: ids[start : start + AT_ONCE]})
        resources += complete_resources(connection, rows.all())
    return tuple(resources)


def complete_resources(connection: Connection, rows: Sequence[Row[object]]) -> tuple[Resource, ...]:
    """Read dependencies and objects of resources. The rows are those of `WITH_JOBS`."""
    # Two queries for all resources of a page, instead of two for each.
    by_id = {str(row[0]): row for row in rows}
    needs: dict[str, list[tuple[str, str]]] = {identifier: [] for identifier in by_id}
    objects: dict[str, dict[str, OwnedObject]] = {identifier: {} for identifier in by_id}
    if by_id:
        those = {_IDS: list(by_id)}
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


IDS = "ids"
RowValues = dict[str, Any]
_KINDS = (
    select(RESOURCES.c.id, RESOURCES.c.kind)
    .where(RESOURCES.c.id.in_(bindparam(IDS, expanding=True)))
    # The share lock keeps the needed resources from being deleted before this transaction ends.
    .with_for_update(read=True)
)
_INSERTING = {table: insert(table) for table in (RESOURCES, DEPENDENCIES, OBJECTS, RETRIES)}


def insert_resources(
    session: Session, objects: ObjectStore, several: Sequence[NewResource], owner: str | None
) -> list[Resource]:
    """Insert several resources of one owner within a transaction; the caller commits.

    Refuse one whose dependency does not exist; raise `ObjectGone` if an object that one owns does not.
    """
    connection = session.connection()
    _check_dependencies(connection, [need for new in several for need in new.rests_on])
    # One time for all of them: a batch sorts as a whole.
    moment = get_database_time(session)
    resources = [_build_resource(new, moment) for new in several]
    pairs = list(zip(resources, several, strict=True))
    # Resources first: the rows of all other tables refer to them.
    values = [{name: getattr(resource, name) for name in RESOURCE_COLUMNS} for resource in resources]
    _insert_rows(connection, RESOURCES, [{**own, "tags": list(own["tags"]), "owner": owner} for own in values])
    insert_dependencies(
        session, [(resource.id, on_id, role) for resource in resources for role, on_id in resource.rests_on]
    )
    insert_objects(
        session, objects, [(resource.id, owned) for resource in resources for owned in resource.objects.values()]
    )
    _insert_rows(
        connection, RETRIES, [_to_retry_row(resource, new.retry) for resource, new in pairs if new.retry is not None]
    )
    jobs = add_jobs(session, [(new.job, resource.id) for resource, new in pairs if new.job is not None], moment, owner)
    job_of = {job.resource_id: job for job in jobs}
    return [replace(resource, job=job_of.get(resource.id)) for resource in resources]


def insert_dependencies(session: Session, several: Iterable[tuple[str, str, str]]) -> None:
    """Insert dependencies between resources, each as (dependent, needed, role)."""
    rows = [{"dependent_id": dependent, "on_id": on_id, "role": role} for dependent, on_id, role in several]
    _insert_rows(session.connection(), DEPENDENCIES, rows)


def insert_objects(session: Session, objects: ObjectStore, several: Sequence[tuple[str, OwnedObject]]) -> None:
    """Insert the ownership of objects; raise ObjectGone if one is not in the store."""
    lock_objects(session, objects, (owned for _, owned in several))
    _insert_rows(
        session.connection(), OBJECTS, [{"resource_id": identifier, **vars(owned)} for identifier, owned in several]
    )


def _build_resource(new: NewResource, moment: datetime) -> Resource:
    return Resource(
        id=create_identifier(new.kind),
        kind=new.kind,
        name=new.name,
        created_at=moment,
        request=dict(new.request),
        result=None if new.result is None else dict(new.result),
        rests_on=tuple(sorted({(need.role, need.id) for need in new.rests_on})),
        objects={owned.role: owned for owned in new.objects},
        job=None,
    )


def _to_retry_row(resource: Resource, retry: Retry) -> RowValues:
    return {**vars(retry), "resource_id": resource.id, "created_at": resource.created_at}


def _insert_rows(connection: Connection, table: Table, rows: Sequence[RowValues]) -> None:
    # SQLAlchemy would take an empty list for one row of default values.
    if rows:
        connection.execute(_INSERTING[table], rows)


def _check_dependencies(connection: Connection, needs: Sequence[Dependency]) -> None:
    ids = sorted({need.id for need in needs})
    kinds: dict[str, str] = {}
    for start in range(0, len(ids), AT_ONCE):
        rows = connection.execute(_KINDS, {IDS: ids[start : start + AT_ONCE]})
        kinds |= {identifier: kind for identifier, kind in rows}  # noqa: C416
    for need in needs:
        if kinds.get(need.id) != need.kind:
            raise make_unusable(f"there is no {need.kind} {need.id!r}", need.pointer, title="Unknown resource")
