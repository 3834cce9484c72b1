"""`Resources`: create, get, list, label and delete resources; refuses to delete what others need."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from sqlalchemy import func, select
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from dynident_service.problems import Dependent, ProblemError, make_not_found
from dynident_service.storage.database import Database
from dynident_service.storage.database_tables import (
    RESOURCES,
    DependencyRow,
    JobRow,
    ObjectRow,
    ResourceRow,
    RetryRow,
    check_text,
)
from dynident_service.storage.deletion_and_expiry import delete_unowned, raise_tombstones
from dynident_service.storage.object_store import ObjectStore, StoredObject, compute_digest
from dynident_service.storage.quotas import (
    Account,
    QuotaExceeded,
    QuotaLimits,
    check_byte_quota,
    check_quota,
    get_account,
    lock_account,
)
from dynident_service.storage.repository_values import (
    CHANGED,
    FINAL,
    Kind,
    NewResource,
    OwnedObject,
    Page,
    Resource,
    Retry,
    Siblings,
)
from dynident_service.storage.resource_rows import (
    WITH_JOBS,
    complete_resources,
    insert_objects,
    insert_resources,
    read_resource,
    read_resources,
)

MOST_DEPENDENTS = 20
"""Upper limit for the dependents that an error lists."""


class SiblingsCame(ProblemError):
    """Raised where another request was faster to store a resource that depends on the same one."""


class Resources:
    """Repository of the stored resources: robots, measurements, identifications and the rest.

    `limits` are those of accounts that have none of their own.
    """

    def __init__(self, database: Database, objects: ObjectStore, limits: QuotaLimits | None = None) -> None:
        self._database = database
        self._objects = objects
        self._limits = limits or QuotaLimits()
        """Limits of accounts that have none of their own."""

    def create(self, new: NewResource) -> Resource:
        """Store a resource with its dependencies, objects and job, all or nothing.

        A retry (same `Idempotency-Key`, same request) returns the resource of the first request. Raise `ObjectGone` if
        an object was swept away since it was put, `QuotaExceeded` if the account would exceed a limit, `SiblingsCame`
        if there are others than the siblings that it names.
        """

        def insert(session: Session, owner: str | None) -> Resource:
            if new.siblings is not None:
                _refuse_beside_others(session, new.kind, new.siblings)
            return insert_resources(session, self._objects, [new], owner)[0]

        return self._create(new.retry, [new], insert)

    def create_together(self, several: Sequence[NewResource], last: Callable[[list[str]], NewResource]) -> Resource:
        """Store many resources and a last one that is made from their ids, in one transaction.

        The retry key of the last one is that of the request. It is returned.
        """

        def insert(session: Session, owner: str | None) -> Resource:
            ids = [resource.id for resource in insert_resources(session, self._objects, several, owner)]
            return insert_resources(session, self._objects, [last(ids)], owner)[0]

        # The retry key does not depend on the ids, which are not known yet.
        return self._create(last([]).retry, several, insert)

    def find_retried(self, retry: Retry | None) -> Resource | None:
        """Return the resource that an earlier request with the same retry key created, or None.

        Refuse (422) a key that was used with another request.
        """
        if retry is None:
            return None
        with self._database.read() as session:
            row = session.get(RetryRow, (retry.scope, retry.key))
            if row is None:
                return None
            # The same key with another request is a mistake of the client: neither answer would be right.
            if row.fingerprint != retry.fingerprint:
                detail = f"The Idempotency-Key {retry.key!r} was used with another request; use a new key for this one."
                raise ProblemError(422, detail, title="Idempotency-Key used twice")
            return read_resource(session, row.resource_id)

    def get(self, kind: Kind, identifier: str) -> Resource:
        """Return a resource; raise a problem 404 if there is none of this kind."""
        resource = self.find(identifier)
        if resource is None or resource.kind != kind:
            raise make_not_found(kind, identifier)
        return resource

    def find(self, identifier: str) -> Resource | None:
        """Return a resource of any kind, or None."""
        with self._database.read() as session:
            return read_resource(session, identifier)

    def find_all(self, identifiers: Iterable[str]) -> dict[str, Resource]:
        """Return the resources of any kind with these ids, as far as they exist, by id."""
        with self._database.read() as session:
            return {resource.id: resource for resource in read_resources(session, identifiers)}

    def update_labels(
        self,
        kind: Kind,
        identifier: str,
        *,
        name: str | None = None,
        tags: Sequence[str] | None = None,
        archived: bool | None = None,
        request: Mapping[str, object] | None = None,
    ) -> Resource:
        """Change name, tags or archive flag of a resource, or fields of its request; None leaves a value as it is.

        Refuse (404) if there is no such resource.
        """
        with self._database.write() as session:
            row = session.get(ResourceRow, identifier, with_for_update=True)
            if row is None or row.kind != kind:
                raise make_not_found(kind, identifier)
            if name is not None:
                row.name = name
            if tags is not None:
                check_text(*tags)
                row.tags = list(tags)
            if archived is not None:
                row.archived = archived
            if request:
                # Another mapping: changes within the stored one would not be noticed.
                row.request = {**row.request, **request}
        return self.get(kind, identifier)

    def attach(
        self,
        kind: Kind,
        identifier: str,
        result: Mapping[str, object],
        objects: Sequence[OwnedObject],
        *,
        instead_of: Resource | None = None,
        dropped: Sequence[str] = (),
    ) -> Resource:
        """Add to the result of a resource and to its objects; objects of the same roles, and `dropped`, are replaced.

        Raises as `create`, 404 if there is no such resource, and 409 if its result is no more that of `instead_of`.
        """
        with self._database.write() as session:
            payer = self._find_paying_account(session, identifier)
            # The lock of the account comes before that of the row, as in `create`: the same order prevents a deadlock.
            lock_account(session, payer)
            row = session.get(ResourceRow, identifier, with_for_update=True)
            if row is None or row.kind != kind:
                raise make_not_found(kind, identifier)
            if instead_of is not None and row.result != instead_of.result:
                detail = f"Another request has just changed the {kind} {identifier}; look at it, and try again."
                raise ProblemError(409, detail, title=CHANGED)
            # A new mapping: SQLAlchemy sees a change only where the value is another object.
            row.result = {**(row.result or {}), **result}
            roles = [*(owned.role for owned in objects), *dropped]
            before = select(ObjectRow).where(ObjectRow.resource_id == identifier, ObjectRow.role.in_(roles))
            gone = list(session.scalars(before))
            raise_tombstones(session, [row.key for row in gone])
            for former in gone:
                session.delete(former)
            # The new objects have the same roles: the rows of the former ones have to be gone before.
            session.flush()
            check_byte_quota(session, payer, objects)
            insert_objects(session, self._objects, [(identifier, owned) for owned in objects])
        return self.get(kind, identifier)

    def list_page(
        self, kind: Kind, limit: int, cursor: str | None = None, on_id: str | None = None, *, archived: bool = True
    ) -> Page:
        """List resources of a kind, newest first. `on_id` lists only resources that depend on this one."""
        columns = RESOURCES.c
        query = WITH_JOBS.where(columns.kind == kind).order_by(columns.id.desc()).limit(limit + 1)
        if cursor is not None:
            query = query.where(columns.id < cursor)
        if not archived:
            query = query.where(columns.archived.is_(False))
        if on_id is not None:
            # In the query, so that a page is full although most resources rest on others.
            resting = select(DependencyRow.dependent_id).where(DependencyRow.on_id == on_id)
            query = query.where(columns.id.in_(resting))
        with self._database.read() as session:
            connection = session.connection()
            rows = connection.execute(query).all()
            items = complete_resources(connection, rows[:limit])
        # One row more than asked for was read: it tells whether there is a next page.
        return Page(items, items[-1].id if len(rows) > limit else None)

    def delete(self, kind: Kind, identifier: str, *, with_kind: Kind | None = None) -> None:
        """Delete a resource with its job and objects, and what depends on it of `with_kind`.

        Refuse with 404 if there is none, with 409 if others depend on it or a job is not finished.
        """
        with self._database.write() as session:
            row = session.get(ResourceRow, identifier, with_for_update=True)
            if row is None or row.kind != kind:
                raise make_not_found(kind, identifier)
            # The row is locked: nobody comes to depend on the resource between this check and its end.
            parts = [] if with_kind is None else _list_dependents(session, row.id, with_kind)
            for part in parts:
                _delete_row(session, part)
            _delete_row(session, row)

    def check_room(self, kind: Kind, files: Sequence[Path], attached_to: str | None = None) -> None:
        """Check that there is room for files before they are put into the store; it is checked again with their owner.

        `attached_to` is an existing resource that will own them; without it a new one will. Raise `QuotaExceeded` if
        not.
        """
        account = get_account()
        with self._database.read() as session:
            if attached_to is not None:
                account = self._find_paying_account(session, attached_to)
            if account is None or not (account.limits.bytes or account.limits.recordings):
                return
            owned = []
            for file in files:
                with file.open("rb") as opened:
                    # By their hashes: a file that the account has already takes no room.
                    owned.append(OwnedObject(file.name, *compute_digest(opened), ""))
            if attached_to is None:
                check_quota(session, account, [NewResource(kind, {}, objects=tuple(owned))])
            else:
                check_byte_quota(session, account, owned)

    def _find_paying_account(self, session: Session, identifier: str) -> Account | None:
        """Return the account that pays for files of a resource, which is its owner's; None where no limit applies."""
        account = get_account()
        if not self._limits.bytes and (account is None or not account.limits.bytes):
            return None
        owner = session.scalar(select(ResourceRow.owner).where(ResourceRow.id == identifier))
        if owner is None or (account is not None and account.name == owner):
            return None if owner is None else account
        # Files of another key's resource count for that key, with the limits of the settings.
        return Account(owner, self._limits)

    def _create(
        self, retry: Retry | None, several: Sequence[NewResource], inserted: Callable[[Session, str | None], Resource]
    ) -> Resource:
        account = get_account()
        try:
            with self._database.write() as session:
                # What the account uses is counted under the lock: two requests cannot both take the last room.
                lock_account(session, account)
                check_quota(session, account, several)
                return inserted(session, None if account is None else account.name)
        except (IntegrityError, QuotaExceeded, SiblingsCame):
            # Another request with the same key was faster: its resource is the answer.
            known = self.find_retried(retry)
            if known is None:
                raise
            return known

    def put(self, content: bytes | Path) -> StoredObject:
        """Put bytes or a file into the object store; the sweep deletes them unless a resource comes to own them."""
        with io.BytesIO(content) if isinstance(content, bytes) else content.open("rb") as file:
            key, size = compute_digest(file)
            with self._database.write() as session:
                # Before the object is put, in a transaction of its own: see `tombstones`.
                raise_tombstones(session, (key,))
            return self._objects.put_hashed(file, key, size)

    def delete_object(self, key: str) -> None:
        """Delete an object that a resource has just given up, unless another one owns it, before the sweep does."""
        delete_unowned(self._database, self._objects, key)

    def put_with_role(self, role: str, content: bytes | Path, media_type: str) -> OwnedObject:
        """Put bytes or a file into the object store, and return them as an object with a role."""
        stored = self.put(content)
        return OwnedObject(role, stored.key, stored.size, media_type)


def _refuse_beside_others(session: Session, kind: Kind, siblings: Siblings) -> None:
    # The row stays locked: of two requests at the same time, the second finds what the first stored.
    session.get(ResourceRow, siblings.on_id, with_for_update=True)
    query = (
        select(ResourceRow.id)
        .join(DependencyRow, DependencyRow.dependent_id == ResourceRow.id)
        .where(DependencyRow.on_id == siblings.on_id, ResourceRow.kind == kind)
        .order_by(ResourceRow.id.desc())
        .limit(len(siblings.ids) or 1)
    )
    others = set(session.scalars(query)) - set(siblings.ids)
    if others:
        detail = f"Another request has just made the {kind} {min(others)}; look at it, and try again."
        raise SiblingsCame(409, detail, title="Made at the same time")


def _list_dependents(session: Session, on_id: str, kind: Kind) -> list[ResourceRow]:
    resting = select(DependencyRow.dependent_id).where(DependencyRow.on_id == on_id)
    query = select(ResourceRow).where(ResourceRow.kind == kind, ResourceRow.id.in_(resting)).with_for_update()
    return list(session.scalars(query))


def _delete_row(session: Session, row: ResourceRow) -> None:
    _refuse_while_needed(session, row)
    raise_tombstones(session, session.scalars(select(ObjectRow.key).where(ObjectRow.resource_id == row.id)))
    session.delete(row)
    # Whoever is checked next is not needed by a row that is gone.
    session.flush()


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
        named = ", ".join(f"{dependent.kind} {dependent.id}" for dependent in dependents[:10])
        more = f" and {number - 10} more" if number > 10 else ""
        detail = f"The {row.kind} {row.id} is needed by {named}{more}; delete these first."
        raise ProblemError(409, detail, title="Still needed", dependents=dependents, dependents_count=number)
    job = session.scalar(select(JobRow).where(JobRow.resource_id == row.id))
    if job is not None and job.state not in FINAL:
        detail = f"The {row.kind} {row.id} is being computed; cancel its job {job.id} first."
        raise ProblemError(409, detail, title="Still being computed")
