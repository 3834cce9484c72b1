"""Backup of all that is stored, beside the running service, and restoring it after a loss of everything."""

from __future__ import annotations

import contextlib
import fcntl
import os
import tempfile
import zipfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from alembic.script import ScriptDirectory
from sqlalchemy import Connection, Table, func, insert, select, text
from sqlalchemy.exc import IntegrityError, StatementError

from dynident.errors import DynidentError
from dynident_service.problems import ProblemError
from dynident_service.storage.archive import (
    Files,
    Folder,
    Zipped,
    check_listing,
    read_manifest,
    read_object,
    read_rows,
    tables_of,
    write_manifest,
    write_object,
    write_rows,
)
from dynident_service.storage.database import WRITES, Database
from dynident_service.storage.migrate import configuration
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.patience import reason_of
from dynident_service.storage.records import FINAL
from dynident_service.storage.tables import OBJECTS, CheckpointRow, ObjectRow, ResourceRow
from dynident_service.storage.tables import Table as Base

AT_ONCE = 500
"""Rows that are read or written at a time."""
ZIP = ".zip"


@dataclass(frozen=True)
class Amount:
    """How much was written or read."""

    rows: int
    objects: int
    bytes: int


@contextmanager
def files_to_write(target: Path) -> Iterator[Files]:
    """Open an archive: a ZIP where the name ends in .zip, else a folder. Either is there once its manifest is.

    Raises
    ------
    DynidentError
        While another process writes the same.
    """
    if target.suffix.lower() != ZIP:
        target.mkdir(parents=True, exist_ok=True, mode=0o700)
        with _open_alone(target, os.O_RDONLY):
            files = Folder(target)
            files.begin_tables()
            yield files
        return
    unfinished = target.with_name(target.name + ".part")
    with _open_alone(unfinished, os.O_RDWR | os.O_CREAT) as handle:
        try:
            os.ftruncate(handle, 0)  # what a process left that was killed
            with os.fdopen(handle, "r+b", closefd=False) as file:
                with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as zipped:
                    yield Zipped(zipped)
                file.flush()
                os.fsync(handle)
            unfinished.replace(target)
        finally:
            unfinished.unlink(missing_ok=True)


@contextmanager
def _open_alone(path: Path, flags: int) -> Iterator[int]:
    """Open a file or a folder that no other process has open in this way; the system ends this with the process."""
    handle = os.open(path, flags, 0o600)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield handle
    except BlockingIOError as error:
        raise DynidentError(f"another process writes {path}; wait until it has ended", title="In use") from error
    finally:
        os.close(handle)


@contextmanager
def files_to_read(source: Path, most: int | None = None) -> Iterator[Files]:
    """Open an archive to read it; DynidentError where there is none, or one of far more files than `most`."""
    if source.is_dir():
        yield Folder(source)
        return
    try:
        if most is not None:
            check_listing(source, most)
        zipped = zipfile.ZipFile(source)
    except (OSError, zipfile.BadZipFile, NotImplementedError) as error:
        raise DynidentError(f"{source} is no archive of dynident: {error}", title="Unusable archive") from error
    with zipped:
        files = Zipped(zipped)
        files.check()
        yield files


def back_up(database: Database, objects: ObjectStore, target: Path) -> Amount:
    """Write all that is stored into an archive; into a folder that has one, only the objects that are new.

    All rows are of one moment. Most objects are copied before it, since that may take hours, and what is deleted
    meanwhile is kept for a while only; the few that came meanwhile after it. A process that is killed at any instant
    leaves the archive of before whole, and the next one removes what it left.
    """
    with files_to_write(target) as files:
        if isinstance(files, Folder):
            files.clean(tables_of(files))
        with database.engine.connect() as connection:
            owned = _owned(connection)
        for key, size in owned.items():
            with contextlib.suppress(ProblemError):  # deleted since; of any other the second round says it
                _copy(objects, files, key, size)
        with database.one_moment() as connection:
            counts = {table.name: write_rows(files, table.name, _rows(connection, table)) for table in tables()}
            owned = _owned(connection)
            revision = revision_of(connection)
        for key, size in owned.items():
            _copy(objects, files, key, size)
        write_manifest(files, "everything", revision, counts)
        if isinstance(files, Folder):
            files.clean(files.tables, owned)
    return Amount(sum(counts.values()), len(owned), sum(owned.values()))


def _owned(connection: Connection) -> dict[str, int]:
    """The size of each object that belongs to a resource, by its key."""
    rows = connection.execute(select(ObjectRow.key, ObjectRow.size).distinct()).all()
    return {row.key: row.size for row in rows}


def _copy(objects: ObjectStore, files: Files, key: str, size: int) -> None:
    if files.size(f"objects/{key}") != size:
        write_object(files, key, objects.stream(key))


def restore(database: Database, objects: ObjectStore, source: Path, scratch: Path) -> Amount:
    """Read all of an archive into an empty database (brought up to date) and its object store.

    What was being computed is queued again. DynidentError where there is something already, or the archive is cut.
    """
    with files_to_read(source) as files:
        with database.engine.connect() as connection:
            said = read_manifest(files, "everything", known_revisions(connection))
            if connection.execute(select(ResourceRow.id).limit(1)).first() is not None:
                detail = "there is data already; restore into an empty data directory (and database)"
                raise DynidentError(detail, title="Not empty")
        owned: Iterable[dict[str, Any]] = read_rows(files, OBJECTS)
        keys = sorted({(row["key"], row["size"]) for row in owned})
        size = sum(put_object(files, objects, key, scratch) for key, _ in keys)
        try:
            read = _read_tables(database, files, said["counts"])
        except (IntegrityError, StatementError, ValueError, TypeError) as error:
            detail = f"the archive is cut or damaged: {reason_of(error)}"
            raise DynidentError(detail, title="Unusable archive") from error
    return Amount(sum(read.values()), len(keys), size)


def _read_tables(database: Database, files: Files, counts: Mapping[str, int]) -> dict[str, int]:
    with database.engine.execution_options(**{WRITES: True}).begin() as connection:
        for table in reversed(tables()):
            connection.execute(table.delete())
        read = {table.name: _insert(connection, table, files) for table in tables()}
        _count_on(connection)
        lacking = [name for name, number in read.items() if number != counts.get(name, 0)]
        if lacking:
            raise ValueError(f"rows are missing in {', '.join(lacking)}")
    return read


def put_object(files: Files, objects: ObjectStore, key: str, scratch: Path) -> int:
    """Copy an object of an archive into the store; tells its size."""
    scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=scratch) as file:
        size = read_object(files, key, file)
        objects.put_hashed(file, key, size)
    return size


def tables() -> list[Table]:
    """All tables that are kept, those first that others refer to; a checkpoint only saves time."""
    return [table for table in Base.metadata.sorted_tables if table.name != CheckpointRow.__tablename__]


def revision_of(connection: Connection) -> str:
    """The migration that a database is at."""
    return str(connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one())


def known_revisions(connection: Connection) -> set[str]:
    """All migrations that this version knows: archives of these can be read."""
    scripts = ScriptDirectory.from_config(configuration(connection))
    return {script.revision for script in scripts.walk_revisions()}


def _rows(connection: Connection, table: Table) -> Iterator[Any]:
    for part in connection.execute(select(table)).mappings().partitions(AT_ONCE):
        yield from part


def _insert(connection: Connection, table: Table, files: Files) -> int:
    number, batch = 0, []
    for row in read_rows(files, table):
        batch.append(_at_rest(row) if table.name == "jobs" else row)
        number += 1
        if len(batch) == AT_ONCE:
            connection.execute(insert(table), batch)
            batch = []
    if batch:
        connection.execute(insert(table), batch)
    return number


def _at_rest(job: dict[str, Any]) -> dict[str, Any]:
    """A job that nobody works on any more: what had not ended waits again."""
    if job["state"] in FINAL:
        return job
    return {**job, "state": "queued", "lease_until": None, "started_at": None, "fraction": 0.0, "message": ""}


def _count_on(connection: Connection) -> None:
    """Have PostgreSQL number further events after those that were read."""
    if connection.dialect.name == "postgresql":
        events = Base.metadata.tables["job_events"]
        last = connection.execute(select(func.max(events.c.id))).scalar_one()
        if last is not None:
            sequence = func.pg_get_serial_sequence("job_events", "id")
            connection.execute(select(func.setval(sequence, last)))
