"""Delete expired data, unused imports (after a day) and objects that nobody owns (tombstones).

Objects are stored under the hash of their bytes, so two resources may own the same one, and one resource may be deleted
in the moment in which the other is created. Three rules protect owned objects:

1. Before an object is put, its tombstone is raised (`raise_tombstones`); a resource that gives up an object raises it
   in the same transaction. Wherever a process is cut off, every object has an owner or a tombstone.
2. Who comes to own an object checks that it is there, and locks it until the ownership is committed (`lock_objects`).
3. The sweep deletes an object only if its tombstone is old, the sweep has the lock for itself, and nobody owns it.

By 2 and 3, either the sweep sees the owner and spares the object, or the owner sees that the object is gone and puts it
again. The lock is the single writer of SQLite, and an advisory lock of the key on PostgreSQL.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import delete, func, select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from dynident_service.storage.database import Database, get_database_time
from dynident_service.storage.database_tables import (
    DependencyRow,
    JobEventRow,
    JobRow,
    ObjectRow,
    ResourceRow,
    RetryRow,
    TombstoneRow,
)
from dynident_service.storage.object_store import ObjectGone, ObjectStore
from dynident_service.storage.repository_values import OwnedObject

IMPORT_LIFETIME = 24 * 3600.0
"""Seconds after which an unused import is deleted."""
AT_ONCE = 200
"""Imports, or jobs with their events, that one transaction deletes, so that other writers do not wait long."""


def delete_expired(database: Database, age: timedelta) -> int:
    """Delete retry keys and events of jobs that ended more than `age` ago.

    The last event of each job stays, as it says how the job ended. Return the number of jobs whose events were deleted.
    """
    with database.write() as session:
        session.execute(delete(RetryRow).where(RetryRow.created_at < get_database_time(session) - age))
    forgotten = 0
    # Transaction by transaction: others can write in between.
    while number := _delete_events(database, age):
        forgotten += number
    return forgotten


def _delete_events(database: Database, age: timedelta) -> int:
    with database.write() as session:
        old = (
            select(JobEventRow.job_id, func.max(JobEventRow.id))
            .join(JobRow, JobRow.id == JobEventRow.job_id)
            .where(JobRow.finished_at < get_database_time(session) - age)
            .group_by(JobEventRow.job_id)
            .having(func.count() > 1)
            .limit(AT_ONCE)
        )
        jobs = session.execute(old).all()
        for job_id, last in jobs:
            session.execute(delete(JobEventRow).where(JobEventRow.job_id == job_id, JobEventRow.id < last))
    return len(jobs)


def delete_unused_imports(database: Database, age: timedelta) -> int:
    """Delete the imports older than `age` on which nothing depends, at most `AT_ONCE`; return their number."""
    with database.write() as session:
        used = select(DependencyRow.on_id).where(DependencyRow.on_id == ResourceRow.id).exists()
        old = session.scalars(
            select(ResourceRow)
            .where(ResourceRow.kind == "import", ResourceRow.created_at < get_database_time(session) - age, ~used)
            .limit(AT_ONCE)
        ).all()
        for row in old:
            raise_tombstones(session, session.scalars(select(ObjectRow.key).where(ObjectRow.resource_id == row.id)))
            session.delete(row)
        return len(old)


def raise_tombstones(session: Session, keys: Iterable[str]) -> None:
    """Raise the tombstones of objects, or renew their time."""
    since = get_database_time(session)
    dialect: Any = sqlite if _is_sqlite(session) else postgresql
    for key in sorted(set(keys)):  # in one order, so that two who raise several never wait for each other
        row = dialect.insert(TombstoneRow).values(key=key, since=since)
        session.execute(row.on_conflict_do_update(index_elements=[TombstoneRow.key], set_={"since": since}))


def lock_objects(session: Session, objects: ObjectStore, owned: Iterable[OwnedObject]) -> None:
    """Lock objects against the sweep until the end of the transaction.

    Raise `ObjectGone` if one is not in the store with the right size.
    """
    # All transactions lock in the same order, so that no two wait for each other.
    for owned_object in sorted(owned, key=lambda owned_object: owned_object.key):
        if not _is_sqlite(session):
            session.execute(select(func.pg_advisory_xact_lock_shared(_get_lock_number(owned_object.key))))
        if objects.get_size(owned_object.key) != owned_object.size:
            raise ObjectGone(owned_object.key)


def sweep_objects(database: Database, objects: ObjectStore, grace: timedelta) -> int:
    """Delete the objects whose tombstone is older than `grace` and that nobody owns, each in its own transaction.

    Return their number.
    """
    with database.read() as session:
        until = get_database_time(session) - grace
        due = session.scalars(select(TombstoneRow.key).where(TombstoneRow.since <= until)).all()
    return sum(_sweep_one(database, objects, key, until) for key in due)


def delete_unowned(database: Database, objects: ObjectStore, key: str) -> None:
    """Delete an object whose tombstone was raised before, unless somebody owns it."""
    with database.read() as session:
        until = get_database_time(session)
    _sweep_one(database, objects, key, until)


def _sweep_one(database: Database, objects: ObjectStore, key: str, until: datetime) -> bool:
    with database.write() as session:
        if not _is_sqlite(session) and not session.scalar(
            select(func.pg_try_advisory_xact_lock(_get_lock_number(key)))
        ):
            return False  # somebody is about to own it
        # The tombstone goes first: a transaction that raises it again meanwhile either waits for this one, or has
        # committed before and given it a new time, so that nothing is deleted here.
        gone = delete(TombstoneRow).where(TombstoneRow.key == key, TombstoneRow.since <= until)
        if session.scalar(gone.returning(TombstoneRow.key)) is None:
            return False
        # Somebody owns it again: the tombstone is gone, and the object stays.
        if session.scalar(select(ObjectRow.key).where(ObjectRow.key == key).limit(1)) is not None:
            return False
        objects.delete(key)
        return True


def _is_sqlite(session: Session) -> bool:
    return session.get_bind().dialect.name == "sqlite"


def _get_lock_number(key: str) -> int:
    """Return the number of an object's advisory lock: 64 bits of its hash, signed."""
    return int.from_bytes(bytes.fromhex(key[:16]), "big", signed=True)
