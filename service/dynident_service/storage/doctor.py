"""Looks through all that is stored: what is missing, damaged, cannot be read, or is kept for nobody."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from sqlalchemy import select, text
from sqlalchemy.exc import DatabaseError

from dynident_service.storage.database import AT_ONCE, Database
from dynident_service.storage.objects import PROBE_KEY, ObjectStore
from dynident_service.storage.reading import read_those
from dynident_service.storage.records import Resource
from dynident_service.storage.tables import ObjectRow, ResourceRow, TombstoneRow
from dynident_service.storage.tombstones import announce

LEFT_AFTER = 24 * 3600.0
"""An unfinished object that has not changed for so many seconds was left behind by a writer that was cut off."""

Trouble = Literal["database", "missing", "cut", "damaged", "unreadable", "orphan", "leftover"]
REMEDIES: dict[Trouble, str] = {
    "database": "restore the last backup into a new data directory (`dynident restore`)",
    "missing": "upload the same file again",
    "cut": "upload the same file again",
    "damaged": "upload the same file again",
    "unreadable": "ask for it again, its request is kept; or read it with the version of dynident that wrote it",
    "orphan": "`dynident doctor --repair` removes it",
    "leftover": "`dynident doctor --repair` removes it",
}
"""What is to be done."""
CURABLE: frozenset[Trouble] = frozenset({"orphan", "leftover"})
"""What can be put right without losing anything that anybody owns."""


@dataclass(frozen=True)
class Finding:
    """One thing that is not as it should be."""

    trouble: Trouble
    what: str
    """The object's key, a file's path, the id of a resource, or the place in the database."""
    detail: str
    owners: tuple[str, ...] = ()

    @property
    def is_curable(self) -> bool:
        """Whether `repair` can put it right."""
        return self.trouble in CURABLE


def examine(
    database: Database,
    objects: ObjectStore,
    *,
    by_hash: bool = True,
    problem_of: Callable[[Resource], str | None] | None = None,
) -> Iterator[Finding]:
    """Go through all that is stored, and give what is wrong.

    Parameters
    ----------
    database, objects
        What is stored.
    by_hash : bool
        Whether contents are read, and not only sizes.
    problem_of : callable, optional
        Tells what of a resource this version cannot read, and why; left out, nobody tries.
    """
    found = list(examine_database(database))
    yield from found
    if found:
        return  # what a damaged database says of objects is not to be relied on
    if problem_of is not None:
        yield from _unreadable(database, problem_of)
    owners = _owners(database)
    sizes = dict(objects.listed())
    for (key, size), names in owners.items():
        finding = _examine_object(key, size, sizes.get(key), names)
        if finding is None and by_hash and objects.is_damaged(key):
            finding = Finding("damaged", key, "the file's hash is not what it should be", names)
        if finding is not None:
            yield finding
    yield from _orphans(database, sizes.keys() - {key for key, _ in owners} - {PROBE_KEY})
    yield from _leftovers(objects)


def examine_database(database: Database) -> Iterator[Finding]:
    """Look for damaged pages of an SQLite file; PostgreSQL looks after its own."""
    if not database.is_sqlite:
        return
    try:
        with database.engine.connect() as connection:
            for (said,) in connection.execute(text("PRAGMA quick_check(20)")):
                if said != "ok":
                    yield Finding("database", database.engine.url.database or "", str(said))
            # A file that lost its journal may be sound and have no tables.
            connection.execute(select(ObjectRow.key).limit(1))
    except DatabaseError as error:
        yield Finding("database", database.engine.url.database or "", str(error.orig))


def repair(database: Database, objects: ObjectStore, finding: Finding) -> None:
    """Put right what can be: orphans get a tombstone (the sweep deletes them), leftovers are removed."""
    if finding.trouble == "orphan":
        with database.write() as session:
            announce(session, (finding.what,))
    elif finding.trouble == "leftover":
        Path(finding.what).unlink(missing_ok=True)
    else:
        raise ValueError(f"{finding.trouble} cannot be put right")


def _unreadable(database: Database, problem_of: Callable[[Resource], str | None]) -> Iterator[Finding]:
    with database.read() as session:
        ids = list(session.scalars(select(ResourceRow.id).order_by(ResourceRow.id)))
    for start in range(0, len(ids), AT_ONCE):
        with database.read() as session:
            resources = read_those(session, ids[start : start + AT_ONCE])
        for resource in resources:
            problem = problem_of(resource)
            if problem is not None:
                yield Finding("unreadable", resource.id, problem)


def _owners(database: Database) -> dict[tuple[str, int], tuple[str, ...]]:
    owners: dict[tuple[str, int], tuple[str, ...]] = {}
    with database.read() as session:
        query = select(ObjectRow.key, ObjectRow.size, ObjectRow.resource_id).order_by(ObjectRow.key)
        for key, size, resource_id in session.execute(query):
            owners[key, size] = (*owners.get((key, size), ()), resource_id)
    return owners


def _examine_object(key: str, size: int, found: int | None, owners: tuple[str, ...]) -> Finding | None:
    if found is None:
        return Finding("missing", key, "the file is not there", owners)
    if found != size:
        return Finding("cut", key, f"the file has {found} bytes and should have {size}", owners)
    return None


def _orphans(database: Database, suspects: set[str]) -> Iterator[Finding]:
    with database.read() as session:
        # Read after the list: whoever put an object has raised its tombstone before.
        marked = set(session.scalars(select(TombstoneRow.key))) | set(session.scalars(select(ObjectRow.key)))
    for key in sorted(suspects - marked):
        yield Finding("orphan", key, "no resource owns the file")


def _leftovers(objects: ObjectStore) -> Iterator[Finding]:
    for path in objects.leftovers():
        age = time.time() - path.stat().st_mtime
        if age > LEFT_AFTER:
            yield Finding("leftover", str(path), "a writer that was cut off left the file behind")
