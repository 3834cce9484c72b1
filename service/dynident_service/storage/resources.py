"""The repository of resources: create, get, list and delete, alike for all kinds."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, cast

from sqlalchemy import func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from dynident_service.problems import Dependent, ProblemError, not_found, unusable
from dynident_service.storage.database import Database
from dynident_service.storage.identifiers import new_identifier
from dynident_service.storage.ledger import AT_ONCE, add_jobs, as_job
from dynident_service.storage.objects import ObjectStore, Stored, digest
from dynident_service.storage.records import FINAL, Kind, NewResource, Owned, Page, Resource, RestsOn, Retry
from dynident_service.storage.tables import DependencyRow, JobRow, ObjectRow, ResourceRow, RetryRow, check_text
from dynident_service.storage.tombstones import announce, hold

MOST_DEPENDENTS = 20
"""As many are listed of those that rest on what is to be deleted."""


class Resources:
    """Robots, measurements, identifications, … as stored."""

    def __init__(self, database: Database, objects: ObjectStore) -> None:
        self._database = database
        self._objects = objects

    def create(self, new: NewResource) -> Resource:
        """Store a resource, what it rests on, its objects and its job, or nothing at all.

        A retry (same `Idempotency-Key`, same request) gives the resource of the first time. Raises ObjectGone if an
        object was swept away since it was put.
        """
        return self._create(new.retry, lambda session: insert(session, self._objects, new))

    def create_together(self, several: Sequence[NewResource], last: Callable[[list[str]], NewResource]) -> Resource:
        """Store many resources and, made from their ids, a last one, in one transaction; gives the last one.

        A retry is one of the last one.
        """

        def inserted(session: Session) -> str:
            return insert(session, self._objects, last(insert_all(session, self._objects, several)))

        return self._create(last([]).retry, inserted)

    def known(self, retry: Retry | None) -> Resource | None:
        """Give the resource that an earlier request with this key made, if there was one."""
        if retry is None:
            return None
        with self._database.read() as session:
            row = session.get(RetryRow, (retry.scope, retry.key))
            if row is None:
                return None
            if row.fingerprint != retry.fingerprint:
                detail = f"The Idempotency-Key {retry.key!r} was used with another request; use a new key for this one."
                raise ProblemError(422, detail, title="Idempotency-Key used twice")
            return _load(session, session.get_one(ResourceRow, row.resource_id))

    def get(self, kind: Kind, identifier: str) -> Resource:
        """Read one resource; a problem 404 if there is none."""
        with self._database.read() as session:
            row = session.get(ResourceRow, identifier)
            if row is None or row.kind != kind:
                raise not_found(kind, identifier)
            return _load(session, row)

    def find(self, identifier: str) -> Resource | None:
        """Read a resource of whatever kind."""
        with self._database.read() as session:
            row = session.get(ResourceRow, identifier)
            return None if row is None else _load(session, row)

    def find_all(self, identifiers: Iterable[str]) -> dict[str, Resource]:
        """Read resources of whatever kind by their ids, of those that are there."""
        ids = sorted(set(identifiers))
        found: list[Resource] = []
        with self._database.read() as session:
            for start in range(0, len(ids), AT_ONCE):
                part = select(ResourceRow).where(ResourceRow.id.in_(ids[start : start + AT_ONCE]))
                found += _load_all(session, session.scalars(part).all())
        return {one.id: one for one in found}

    def label(
        self,
        kind: Kind,
        identifier: str,
        *,
        name: str | None = None,
        tags: Sequence[str] | None = None,
        archived: bool | None = None,
    ) -> Resource:
        """Change name, tags or archive of a resource, as far as given; a problem 404 if there is none."""
        with self._database.write() as session:
            row = session.get(ResourceRow, identifier, with_for_update=True)
            if row is None or row.kind != kind:
                raise not_found(kind, identifier)
            if name is not None:
                row.name = name
            if tags is not None:
                check_text(*tags)
                row.tags = list(tags)
            if archived is not None:
                row.archived = archived
        return self.get(kind, identifier)

    def attach(self, kind: Kind, identifier: str, result: Mapping[str, Any], objects: Sequence[Owned]) -> Resource:
        """Add to what came out for a resource, and to the objects that it owns; those of the same role are let go of.

        A problem 404 if there is no such resource; raises ObjectGone if an object was swept away since it was put.
        """
        with self._database.write() as session:
            row = session.get(ResourceRow, identifier, with_for_update=True)
            if row is None or row.kind != kind:
                raise not_found(kind, identifier)
            row.result = {**(row.result or {}), **result}
            roles = [one.role for one in objects]
            before = select(ObjectRow).where(ObjectRow.resource_id == identifier, ObjectRow.role.in_(roles))
            gone = list(session.scalars(before))
            announce(session, [one.key for one in gone])
            for one in gone:
                session.delete(one)
            session.flush()
            own(session, self._objects, identifier, objects)
        return self.get(kind, identifier)

    def page(
        self, kind: Kind, limit: int, cursor: str | None = None, on_id: str | None = None, *, archived: bool = True
    ) -> Page:
        """Read a part of the list of a kind, newest first, of those that rest on `on_id` if that is given.

        Without `archived` those that are archived are left out.
        """
        query = select(ResourceRow).where(ResourceRow.kind == kind).order_by(ResourceRow.id.desc()).limit(limit + 1)
        if cursor is not None:
            query = query.where(ResourceRow.id < cursor)
        if not archived:
            query = query.where(ResourceRow.archived.is_(False))
        if on_id is not None:
            resting = select(DependencyRow.dependent_id).where(DependencyRow.on_id == on_id)
            query = query.where(ResourceRow.id.in_(resting))
        with self._database.read() as session:
            rows = session.scalars(query).all()
            items = _load_all(session, rows[:limit])
        return Page(items, items[-1].id if len(rows) > limit else None)

    def delete(self, kind: Kind, identifier: str) -> None:
        """Delete a resource with its job and objects; a problem 409 if others rest on it or its job still runs."""
        with self._database.write() as session:
            row = session.get(ResourceRow, identifier, with_for_update=True)
            if row is None or row.kind != kind:
                raise not_found(kind, identifier)
            _refuse_while_needed(session, row)
            announce(session, session.scalars(select(ObjectRow.key).where(ObjectRow.resource_id == identifier)))
            session.delete(row)

    def _create(self, retry: Retry | None, inserted: Callable[[Session], str]) -> Resource:
        try:
            with self._database.write() as session:
                return _load(session, session.get_one(ResourceRow, inserted(session)))
        except IntegrityError:
            # Another request with the same key was faster: its resource is the answer.
            known = self.known(retry)
            if known is None:
                raise
            return known

    def put(self, content: bytes | Path) -> Stored:
        """Put bytes or a file into the object store; a sweep deletes them if nobody comes to own them."""
        with io.BytesIO(content) if isinstance(content, bytes) else content.open("rb") as file:
            key, size = digest(file)
            with self._database.write() as session:
                announce(session, (key,))
            return self._objects.put_hashed(file, key, size)


def insert(session: Session, objects: ObjectStore, new: NewResource) -> str:
    """Insert a resource within a transaction; the caller commits."""
    (identifier,) = insert_all(session, objects, [new])
    return identifier


def insert_all(session: Session, objects: ObjectStore, several: Sequence[NewResource]) -> list[str]:
    """Insert resources within a transaction, table by table: as many statements for a thousand as for one, nearly."""
    _require(session, [need for new in several for need in new.rests_on])
    rows = [
        ResourceRow(
            id=new_identifier(new.kind),
            kind=new.kind,
            name=new.name,
            request=dict(new.request),
            result=None if new.result is None else dict(new.result),
        )
        for new in several
    ]
    session.add_all(rows)
    session.flush()
    for row, new in zip(rows, several, strict=True):
        for on_id, role in {(one.id, one.role) for one in new.rests_on}:
            rest(session, row.id, on_id, role)
        own(session, objects, row.id, new.objects)
        if (retry := new.retry) is not None:
            session.add(RetryRow(scope=retry.scope, key=retry.key, fingerprint=retry.fingerprint, resource_id=row.id))
    jobs = [(new.job, row.id) for row, new in zip(rows, several, strict=True) if new.job is not None]
    if jobs:
        add_jobs(session, jobs)
    session.flush()
    return [row.id for row in rows]


def rest(session: Session, identifier: str, on_id: str, role: str) -> None:
    """Record that a resource rests on another."""
    session.add(DependencyRow(dependent_id=identifier, on_id=on_id, role=role))


def own(session: Session, objects: ObjectStore, identifier: str, owned: Sequence[Owned]) -> None:
    """Record the objects that a resource owns; raises ObjectGone if one is not there."""
    hold(session, objects, owned)
    for one in owned:
        session.add(
            ObjectRow(resource_id=identifier, role=one.role, key=one.key, size=one.size, media_type=one.media_type)
        )


def _require(session: Session, needs: Sequence[RestsOn]) -> None:
    ids = sorted({need.id for need in needs})
    kinds: dict[str, str] = {}
    for start in range(0, len(ids), AT_ONCE):
        found = select(ResourceRow.id, ResourceRow.kind).where(ResourceRow.id.in_(ids[start : start + AT_ONCE]))
        # The share lock keeps the needed resources from being deleted before this transaction ends.
        kinds |= {str(one): str(kind) for one, kind in session.execute(found.with_for_update(read=True))}
    for need in needs:
        if kinds.get(need.id) != need.kind:
            raise unusable(f"there is no {need.kind} {need.id!r}", need.pointer, title="Unknown resource")


def _refuse_while_needed(session: Session, row: ResourceRow) -> None:
    query = (
        select(ResourceRow.id, ResourceRow.kind)
        .join(DependencyRow, DependencyRow.dependent_id == ResourceRow.id)
        .where(DependencyRow.on_id == row.id)
        .distinct()
        .order_by(ResourceRow.id)
    )
    number = session.scalar(select(func.count()).select_from(query.order_by(None).subquery())) or 0
    if number:
        listed = session.execute(query.limit(MOST_DEPENDENTS))
        dependents = [Dependent(id=identifier, kind=kind) for identifier, kind in listed]
        named = ", ".join(f"{one.kind} {one.id}" for one in dependents[:10])
        more = f" and {number - 10} more" if number > 10 else ""
        detail = f"The {row.kind} {row.id} is needed by {named}{more}; delete these first."
        raise ProblemError(409, detail, title="Still needed", dependents=dependents, dependents_count=number)
    job = session.scalar(select(JobRow).where(JobRow.resource_id == row.id))
    if job is not None and job.state not in FINAL:
        detail = f"The {row.kind} {row.id} is being computed; cancel its job {job.id} first."
        raise ProblemError(409, detail, title="Still being computed")


def _load(session: Session, row: ResourceRow) -> Resource:
    (loaded,) = _load_all(session, [row])
    return loaded


def _load_all(session: Session, rows: Sequence[ResourceRow]) -> tuple[Resource, ...]:
    """Read what belongs to resources: as many queries for a page of them as for one."""
    ids = [row.id for row in rows]
    needs: dict[str, list[tuple[str, str]]] = {one: [] for one in ids}
    resting = select(DependencyRow.dependent_id, DependencyRow.role, DependencyRow.on_id)
    for dependent, role, on_id in session.execute(resting.where(DependencyRow.dependent_id.in_(ids))):
        needs[dependent].append((role, on_id))
    objects: dict[str, list[Owned]] = {one: [] for one in ids}
    owned = select(ObjectRow.resource_id, ObjectRow.role, ObjectRow.key, ObjectRow.size, ObjectRow.media_type)
    for owner, role, key, size, media_type in session.execute(owned.where(ObjectRow.resource_id.in_(ids))):
        objects[owner].append(Owned(role, key, size, media_type))
    jobs = {job.resource_id: job for job in session.scalars(select(JobRow).where(JobRow.resource_id.in_(ids)))}
    return tuple(_loaded(row, needs[row.id], objects[row.id], jobs.get(row.id)) for row in rows)


def _loaded(
    row: ResourceRow, needs: Sequence[tuple[str, str]], objects: Sequence[Owned], job: JobRow | None
) -> Resource:
    return Resource(
        id=row.id,
        kind=cast(Kind, row.kind),
        name=row.name,
        created_at=row.created_at,
        request=row.request,
        result=row.result,
        rests_on=tuple(needs),
        objects={one.role: one for one in objects},
        job=None if job is None else as_job(job),
        tags=tuple(row.tags),
        archived=row.archived,
    )
