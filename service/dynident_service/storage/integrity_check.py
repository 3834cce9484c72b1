"""Find missing, damaged, unreadable and unowned data, and repair some of it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sqlalchemy import select, text
from sqlalchemy.exc import DatabaseError

from dynident_service.storage.database import AT_ONCE, Database
from dynident_service.storage.database_tables import ObjectRow, ResourceRow, TombstoneRow
from dynident_service.storage.deletion_and_expiry import raise_tombstones
from dynident_service.storage.object_store import PROBE_KEY, ObjectStore
from dynident_service.storage.repository_values import Resource
from dynident_service.storage.resource_rows import read_resources

ABANDONED_AFTER = 24 * 3600.0
"""Seconds without a change after which an unfinished object counts as abandoned by its writer."""

Trouble = Literal["database", "missing", "cut", "damaged", "unreadable", "orphan", "leftover"]
REMEDIES: dict[Trouble, str] = {
    "database": "restore the last backup into a new data directory (`dynident restore`)",
    "missing": "upload the same file again",
    "cut": "upload the same file again",
    "damaged": "upload the same file again",
    "unreadable": "compute it again, its request is stored; or read it with the version of dynident that wrote it",
    "orphan": "`dynident doctor --repair` removes it",
    "leftover": "`dynident doctor --repair` removes it",
}
"""What the user should do about each kind of trouble."""
REPAIRABLE: frozenset[Trouble] = frozenset({"orphan", "leftover"})
"""Kinds of trouble that `repair` removes; nothing that anybody owns is lost by it."""


@dataclass(frozen=True)
class Defect:
    """One defect of the stored data."""

    trouble: Trouble
    what: str
    """Key of the object, path of the file, id of the resource, or place in the database."""
    detail: str
    owners: tuple[str, ...] = ()

    @property
    def is_repairable(self) -> bool:
        """Whether `repair` can remove the defect."""
        return self.trouble in REPAIRABLE


def check_storage(
    database: Database,
    objects: ObjectStore,
    *,
    by_hash: bool = True,
    problem_of: Callable[[Resource], str | None] | None = None,
) -> Iterator[Defect]:
    """Check all stored data and yield the defects.

    With `by_hash` all contents are read, and not only sizes compared. `problem_of` says what this version cannot read
    of a resource; without it resources are not read. If the database itself is damaged, nothing else is checked.
    """
    findings = list(check_database(database))
    yield from findings
    if findings:
        return  # what a damaged database says of objects is not to be relied on
    if problem_of is not None:
        yield from _find_unreadable(database, problem_of)
    owners = _load_owners(database)
    # The list is read after the owners: whatever they owned by then had been put before.
    sizes = dict(objects.list_objects())
    for (key, size), names in owners.items():
        finding = _check_object(key, size, sizes.get(key), names)
        if finding is None and by_hash and objects.is_damaged(key):
            finding = Defect("damaged", key, "the file has the wrong hash", names)
        if finding is not None:
            yield finding
    yield from _find_orphans(database, sizes.keys() - {key for key, _ in owners} - {PROBE_KEY})
    yield from _find_leftovers(objects)


def check_database(database: Database) -> Iterator[Defect]:
    """Check an SQLite file for damaged pages; PostgreSQL checks its own."""
    if not database.is_sqlite:
        return
    try:
        with database.engine.connect() as connection:
            for (answer,) in connection.execute(text("PRAGMA quick_check(20)")):
                if answer != "ok":
                    yield Defect("database", database.engine.url.database or "", str(answer))
            # A file that lost its journal may be sound and have no tables.
            connection.execute(select(ObjectRow.key).limit(1))
    except DatabaseError as error:
        yield Defect("database", database.engine.url.database or "", str(error.orig))


def repair(database: Database, finding: Defect) -> None:
    """Remove a curable defect: an orphan gets a tombstone for the sweep, an abandoned file is deleted."""
    if finding.trouble == "orphan":
        with database.write() as session:
            raise_tombstones(session, (finding.what,))
    elif finding.trouble == "leftover":
        Path(finding.what).unlink(missing_ok=True)
    else:
        raise ValueError(f"{finding.trouble} cannot be repaired")


def _find_unreadable(database: Database, problem_of: Callable[[Resource], str | None]) -> Iterator[Defect]:
    with database.read() as session:
        ids = list(session.scalars(select(ResourceRow.id).order_by(ResourceRow.id)))
    # A transaction for each portion: a long reader keeps SQLite's write-ahead log from being cut back.
    for start in range(0, len(ids), AT_ONCE):
        with database.read() as session:
            resources = read_resources(session, ids[start : start + AT_ONCE])
        for resource in resources:
            problem = problem_of(resource)
            if problem is not None:
                yield Defect("unreadable", resource.id, problem)


def _load_owners(database: Database) -> dict[tuple[str, int], tuple[str, ...]]:
    owners: dict[tuple[str, int], tuple[str, ...]] = {}
    with database.read() as session:
        query = select(ObjectRow.key, ObjectRow.size, ObjectRow.resource_id).order_by(ObjectRow.key)
        for key, size, resource_id in session.execute(query):
            owners[key, size] = (*owners.get((key, size), ()), resource_id)
    return owners


def _check_object(key: str, size: int, actual_size: int | None, owners: tuple[str, ...]) -> Defect | None:
    if actual_size is None:
        return Defect("missing", key, "the file is missing", owners)
    if actual_size != size:
        return Defect("cut", key, f"the file has {actual_size} bytes and should have {size}", owners)
    return None


def _find_orphans(database: Database, suspects: set[str]) -> Iterator[Defect]:
    with database.read() as session:
        # Read after the list: whoever put an object has raised its tombstone before.
        marked = set(session.scalars(select(TombstoneRow.key))) | set(session.scalars(select(ObjectRow.key)))
    for key in sorted(suspects - marked):
        yield Defect("orphan", key, "no resource owns the file")


def _find_leftovers(objects: ObjectStore) -> Iterator[Defect]:
    for path in objects.list_leftovers():
        age = time.time() - path.stat().st_mtime
        # A younger one may still be written.
        if age > ABANDONED_AFTER:
            yield Defect("leftover", str(path), "an interrupted writer left the file behind")
