"""Objects are let go of by a tombstone and swept away later, so that none is deleted that somebody comes to own.

Objects are kept under the hash of their bytes, so two resources may own the same one, and one may be deleted in the
moment in which the other is made. Three rules keep what is owned:

1. Who is about to put an object raises its tombstone before (`announce`); who lets go of one, in the transaction that
   does so. Whatever is cut off in between, every object is owned or has a tombstone.
2. Who comes to own an object looks whether it is there, and holds its lock until the owner is committed (`hold`).
3. The sweep deletes an object only behind an old tombstone, while it has the lock for itself and nobody owns it.

By 2 and 3, either the sweep sees the owner and spares the object, or the owner sees that it is gone and puts it again.
The lock is the one writer of SQLite, and an advisory lock of the key on PostgreSQL.
"""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import delete, func, select
from sqlalchemy.dialects import postgresql, sqlite
from sqlalchemy.orm import Session

from dynident_service.storage.database import Database, clock
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.records import Owned
from dynident_service.storage.tables import ObjectRow, TombstoneRow


class ObjectGone(Exception):
    """An object was swept away before anybody owned it: put it again, then try again."""


def announce(session: Session, keys: Iterable[str]) -> None:
    """Raise the tombstones of objects, or make them young again."""
    since = clock(session)
    dialect: Any = sqlite if _is_sqlite(session) else postgresql
    for key in sorted(set(keys)):  # in one order, so that two who raise several never wait for each other
        row = dialect.insert(TombstoneRow).values(key=key, since=since)
        session.execute(row.on_conflict_do_update(index_elements=[TombstoneRow.key], set_={"since": since}))


def hold(session: Session, objects: ObjectStore, owned: Iterable[Owned]) -> None:
    """Keep the sweep off objects until this transaction ends; raises ObjectGone if one is not there as it should be."""
    for one in sorted(owned, key=lambda each: each.key):
        if not _is_sqlite(session):
            session.execute(select(func.pg_advisory_xact_lock_shared(_number(one.key))))
        if objects.size(one.key) != one.size:
            raise ObjectGone(one.key)


def sweep(database: Database, objects: ObjectStore, grace: timedelta) -> int:
    """Delete the objects that nobody has owned for a while, each in a transaction of its own; tells how many."""
    with database.read() as session:
        until = clock(session) - grace
        due = session.scalars(select(TombstoneRow.key).where(TombstoneRow.since <= until)).all()
    return sum(_sweep_one(database, objects, key, until) for key in due)


def _sweep_one(database: Database, objects: ObjectStore, key: str, until: datetime) -> bool:
    with database.write() as session:
        if not _is_sqlite(session) and not session.scalar(select(func.pg_try_advisory_xact_lock(_number(key)))):
            return False  # somebody is about to own it
        # The tombstone first: who raises it again meanwhile waits here, or is seen here.
        gone = delete(TombstoneRow).where(TombstoneRow.key == key, TombstoneRow.since <= until)
        if session.scalar(gone.returning(TombstoneRow.key)) is None:
            return False
        if session.scalar(select(ObjectRow.key).where(ObjectRow.key == key).limit(1)) is not None:
            return False
        objects.delete(key)
        return True


def _is_sqlite(session: Session) -> bool:
    return session.get_bind().dialect.name == "sqlite"


def _number(key: str) -> int:
    """The number of an object's advisory lock: 64 bits of its hash, signed."""
    return int.from_bytes(bytes.fromhex(key[:16]), "big", signed=True)
