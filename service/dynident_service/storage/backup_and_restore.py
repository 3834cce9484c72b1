"""Back up all stored data while the service runs, and restore it."""

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
from dynident_service.settings import load_settings
from dynident_service.storage.archive_format import (
    ArchiveFiles,
    ArchiveFolder,
    ArchiveZip,
    check_listing,
    find_tables_folder,
    read_manifest,
    read_object,
    read_rows,
    write_manifest,
    write_object,
    write_rows,
)
from dynident_service.storage.data_directory import prepare_data_directory, restrict_file_permissions
from dynident_service.storage.database import WRITES, Database, build_alembic_config, describe_error, migrate
from dynident_service.storage.database_tables import OBJECTS, CheckpointRow, ObjectRow, ResourceRow
from dynident_service.storage.database_tables import Table as Base
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import FINAL

AT_ONCE = 500
"""Rows that are read or written per statement."""
ZIP = ".zip"


@dataclass(frozen=True)
class ArchiveSize:
    """Numbers of rows, objects and bytes that were written or read."""

    rows: int
    objects: int
    bytes: int


@contextmanager
def open_archive_for_writing(target: Path) -> Iterator[ArchiveFiles]:
    """Open an archive for writing: a ZIP if the name ends in .zip, else a folder.

    The archive is valid once its manifest is written. Refuse it while another process writes the same archive.
    """
    if target.suffix.lower() != ZIP:
        # All recordings and the hashes of the keys are in it: nobody else may read it.
        target.mkdir(parents=True, exist_ok=True, mode=0o700)
        with _open_locked(target, os.O_RDONLY):
            files = ArchiveFolder(target)
            files.choose_tables_folder()
            yield files
        return
    unfinished = target.with_name(target.name + ".part")
    with _open_locked(unfinished, os.O_RDWR | os.O_CREAT) as handle:
        try:
            os.ftruncate(handle, 0)  # what a process left that was killed
            with os.fdopen(handle, "r+b", closefd=False) as file:
                with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as zipped:
                    yield ArchiveZip(zipped)
                file.flush()
                os.fsync(handle)
            unfinished.replace(target)
        finally:
            unfinished.unlink(missing_ok=True)


@contextmanager
def _open_locked(path: Path, flags: int) -> Iterator[int]:
    """Open a file or folder under an exclusive lock; the operating system releases it even if the process is killed."""
    handle = os.open(path, flags, 0o600)
    try:
        # Without waiting for the lock: a backup may take hours.
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield handle
    except BlockingIOError as error:
        raise DynidentError(f"another process is writing {path}; wait until it has ended", title="In use") from error
    finally:
        os.close(handle)


@contextmanager
def open_archive_for_reading(source: Path, most: int | None = None) -> Iterator[ArchiveFiles]:
    """Open an archive for reading. Refuse a ZIP that has far more than `most` files."""
    if source.is_dir():
        yield ArchiveFolder(source)
        return
    try:
        if most is not None:
            check_listing(source, most)
        zipped = zipfile.ZipFile(source)
    except (OSError, zipfile.BadZipFile, NotImplementedError) as error:
        raise DynidentError(f"{source} is not an archive of dynident: {error}", title="Unusable archive") from error
    with zipped:
        files = ArchiveZip(zipped)
        files.check_compression()
        yield files


def back_up(database: Database, objects: ObjectStore, target: Path) -> ArchiveSize:
    """Write all stored data into an archive; an existing folder only gets the objects that are new.

    All rows are of one instant. Most objects are copied before that instant, as this may take hours; objects that are
    deleted in the meantime stay in the store for a while, and those that were added in the meantime are copied
    afterwards. A process that is killed leaves the previous archive intact, and the next backup removes the remains.
    """
    with open_archive_for_writing(target) as files:
        if isinstance(files, ArchiveFolder):
            # Remove the remains of a backup that was killed, before the disk is needed for the new one.
            files.remove_unused(find_tables_folder(files))
        with database.engine.connect() as connection:
            owned = _load_object_sizes(connection)
        for key, size in owned.items():
            with contextlib.suppress(ProblemError):  # deleted meanwhile; the second round finds all others
                _copy_object(objects, files, key, size)
        # Rows and the list of owned objects come from one snapshot, so that no row names an object that is not copied
        # below.
        with database.open_snapshot() as connection:
            counts = {
                table.name: write_rows(files, table.name, _iterate_rows(connection, table)) for table in list_tables()
            }
            owned = _load_object_sizes(connection)
            revision = get_revision(connection)
        for key, size in owned.items():
            _copy_object(objects, files, key, size)
        write_manifest(files, "everything", revision, counts)
        if isinstance(files, ArchiveFolder):
            files.remove_unused(files.tables, owned)
    return ArchiveSize(sum(counts.values()), len(owned), sum(owned.values()))


def _load_object_sizes(connection: Connection) -> dict[str, int]:
    """Return the sizes in bytes of all objects that belong to a resource, by key."""
    rows = connection.execute(select(ObjectRow.key, ObjectRow.size).distinct()).all()
    return {row.key: row.size for row in rows}


def _copy_object(objects: ObjectStore, files: ArchiveFiles, key: str, size: int) -> None:
    if files.get_size(f"objects/{key}") != size:
        write_object(files, key, objects.stream(key))


def restore(database: Database, objects: ObjectStore, source: Path, scratch: Path) -> ArchiveSize:
    """Read an archive into an empty database, which has all migrations, and into its object store.

    Jobs that were running when the backup was made are queued again. Refuse an archive that is truncated or damaged,
    and a database that is not empty.
    """
    with open_archive_for_reading(source) as files:
        with database.engine.connect() as connection:
            manifest = read_manifest(files, "everything", list_revisions(connection))
            if connection.execute(select(ResourceRow.id).limit(1)).first() is not None:
                detail = "there are data already; restore into an empty data directory (and database)"
                raise DynidentError(detail, title="Not empty")
        owned: Iterable[dict[str, Any]] = read_rows(files, OBJECTS)
        # Several resources may own one object, which is copied once.
        keys = sorted({(row["key"], row["size"]) for row in owned})
        # Objects before rows: a restoration that is cut off leaves a database that is still empty, and can be repeated.
        size = sum(put_object(files, objects, key, scratch) for key, _ in keys)
        try:
            read = _read_tables(database, files, manifest["counts"])
        except (IntegrityError, StatementError, ValueError, TypeError) as error:
            detail = f"the archive is cut or damaged: {describe_error(error)}"
            raise DynidentError(detail, title="Unusable archive") from error
    return ArchiveSize(sum(read.values()), len(keys), size)


def _read_tables(database: Database, files: ArchiveFiles, counts: Mapping[str, int]) -> dict[str, int]:
    with database.engine.execution_options(**{WRITES: True}).begin() as connection:
        # In reverse order, as rows refer to rows of earlier tables.
        for table in reversed(list_tables()):
            connection.execute(table.delete())
        read = {table.name: _insert_rows(connection, table, files) for table in list_tables()}
        # Before the commit: the first new event would otherwise get an id that is taken.
        _advance_event_ids(connection)
        lacking = [name for name, number in read.items() if number != counts.get(name, 0)]
        if lacking:
            raise ValueError(f"rows are missing in {', '.join(lacking)}")
    return read


def put_object(files: ArchiveFiles, objects: ObjectStore, key: str, scratch: Path) -> int:
    """Copy an object of an archive into the object store. Return its size in bytes."""
    scratch.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryFile(dir=scratch) as file:
        size = read_object(files, key, file)
        objects.put_hashed(file, key, size)
    return size


def list_tables() -> list[Table]:
    """Return the tables that a backup contains, in the order of their foreign keys.

    Checkpoints are left out, as they only save time.
    """
    return [table for table in Base.metadata.sorted_tables if table.name != CheckpointRow.__tablename__]


def get_revision(connection: Connection) -> str:
    """Return the migration that a database is at."""
    return str(connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one())


def list_revisions(connection: Connection) -> set[str]:
    """Return all migrations that this version knows; archives of any of them can be read."""
    scripts = ScriptDirectory.from_config(build_alembic_config(connection))
    return {script.revision for script in scripts.walk_revisions()}


def _iterate_rows(connection: Connection, table: Table) -> Iterator[Any]:
    for part in connection.execute(select(table)).mappings().partitions(AT_ONCE):
        yield from part


def _insert_rows(connection: Connection, table: Table, files: ArchiveFiles) -> int:
    number, batch = 0, []
    for row in read_rows(files, table):
        batch.append(_reset_job(row) if table.name == "jobs" else row)
        number += 1
        if len(batch) == AT_ONCE:
            connection.execute(insert(table), batch)
            batch = []
    if batch:
        connection.execute(insert(table), batch)
    return number


def _reset_job(job: dict[str, Any]) -> dict[str, Any]:
    """Return the row of a job that nobody works on: a job that had not ended is queued again."""
    if job["state"] in FINAL:
        return job
    return {**job, "state": "queued", "lease_until": None, "started_at": None, "fraction": 0.0, "message": ""}


def _advance_event_ids(connection: Connection) -> None:
    """Set PostgreSQL's sequence of event ids, which explicit ids do not advance, to the largest id that was read."""
    if connection.dialect.name == "postgresql":
        events = Base.metadata.tables["job_events"]
        last = connection.execute(select(func.max(events.c.id))).scalar_one()
        if last is not None:
            sequence = func.pg_get_serial_sequence("job_events", "id")
            connection.execute(select(func.setval(sequence, last)))


@contextmanager
def open_storage(
    data_dir: Path | None, *, must_exist: bool, as_it_is: bool = False
) -> Iterator[tuple[Database, ObjectStore, Path]]:
    """Open what a service has stored, and a folder for what is read meanwhile; the database is brought up to date.

    The data directory is that of the settings by default. `as_it_is` leaves older tables as they are, for a check of
    damaged data.
    """
    settings = load_settings() if data_dir is None else load_settings(data_dir=data_dir)
    if must_exist and not settings.database_url and not settings.data_dir.is_dir():
        detail = (
            f"there is no folder {settings.data_dir}; give the data directory of the service (--data-dir, "
            "DYNIDENT_DATA_DIR)"
        )
        raise DynidentError(detail, pointer="--data-dir")
    with restrict_file_permissions():
        prepare_data_directory(settings.data_dir)
        database = Database(settings.database)
        try:
            # Older tables are migrated first; only a check of damaged data leaves them as they are.
            if not as_it_is:
                migrate(database)
            yield database, ObjectStore(settings.objects, settings.cache_dir), settings.uploads_dir
        except ProblemError as error:
            raise DynidentError(error.problem.detail or "", title=error.problem.title) from error
        finally:
            database.close()
