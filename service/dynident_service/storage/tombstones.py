"""Safe deletion of objects: they get a tombstone first and are swept away later, unless somebody owns them again.

Objects are stored under the hash of their bytes, so two resources may own the same one, and one resource may be deleted
in the moment in which the other is created. Three rules protect owned objects:

1. Before an object is put, its tombstone is raised (`raise_tombstones`); a resource that gives up an object raises it
   in the same transaction. Wherever a process is cut off, every object has an owner or a tombstone.
2. Who comes to own an object checks that it is there, and holds its lock until the ownership is committed
   (`lock_objects`).
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
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.records import OwnedObject
from dynident_service.storage.tables import ObjectRow, TombstoneRow


class ObjectGone(Exception):
    """An object was swept away before anybody owned it; put it again and retry."""


def raise_tombstones(session: Session, keys: Iterable[str]) -> None:
    """Raise the tombstones of objects, or renew their time."""
    since = get_database_time(session)
    dialect: Any = sqlite if _is_sqlite(session) else postgresql
    for key in sorted(set(keys)):  # in one order, so that two who raise several never wait for each other
        row = dialect.insert(TombstoneRow).values(key=key, since=since)
        session.execute(row.on_conflict_do_update(index_elements=[TombstoneRow.key], set_={"since": since}))


def lock_objects(session: Session, objects: ObjectStore, owned: Iterable[OwnedObject]) -> None:
    """Lock objects against the sweep until the end of the transaction.

    Raises
    ------
    ObjectGone
        If an object is not in the store with the right size.
    """
    # All transactions lock in the same order, so that no two wait for each other.
    for owned_object in sorted(owned, key=lambda owned_object: owned_object.key):
        if not _is_sqlite(session):
            session.execute(select(func.pg_advisory_xact_lock_shared(_get_lock_number(owned_object.key))))
        if objects.get_size(owned_object.key) != owned_object.size:
            raise ObjectGone(owned_object.key)


def sweep_objects(database: Database, objects: ObjectStore, grace: timedelta) -> int:
    """Delete the objects whose tombstone is older than `grace` and that nobody owns, each in its own transaction.

    Returns
    -------
    int
        Number of objects that were deleted.
    """
    with database.read() as session:
        until = get_database_time(session) - grace
        due = session.scalars(select(TombstoneRow.key).where(TombstoneRow.since <= until)).all()
    return sum(_sweep_one(database, objects, key, until) for key in due)


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
