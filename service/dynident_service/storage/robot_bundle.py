"""Write and read the bundle of one robot, and check its rows."""

from __future__ import annotations

import io
import math
import re
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, get_args

from sqlalchemy import JSON, BigInteger, Boolean, Column, Connection, Float, Integer, Table, insert, select
from sqlalchemy.exc import DataError, IntegrityError
from sqlalchemy.types import TypeEngine

from dynident.errors import DynidentError
from dynident_service.storage.archive_format import (
    ArchiveFiles,
    ArchiveZip,
    make_archive_error,
    read_manifest,
    read_rows,
    write_manifest,
    write_rows,
)
from dynident_service.storage.backup_and_restore import (
    ArchiveSize,
    get_revision,
    list_revisions,
    open_archive_for_reading,
    put_object,
)
from dynident_service.storage.database import Database, describe_error
from dynident_service.storage.database_tables import (
    DependencyRow,
    JobEventRow,
    JobRow,
    ObjectRow,
    ResourceRow,
    Text,
    UtcDateTime,
    get_table,
)
from dynident_service.storage.deletion_and_expiry import lock_objects, raise_tombstones
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import FINAL, KINDS, Kind, OwnedObject, Resource
from dynident_service.storage.resource_rows import JOB_COLUMNS, RESOURCE_COLUMNS, to_resource

LARGEST, LARGEST_BIG = 2**31 - 1, 2**63 - 1
"""Largest values of PostgreSQL's integer columns; SQLite would take larger ones."""


def check_rows(table: Table, rows: Sequence[Mapping[str, object]]) -> None:
    """Check that rows have all columns, with values that every supported database accepts.

    Raise ValueError for the first row that does not.
    """
    named = set(rows[0]) if rows else set()
    lacking = [column.name for column in table.columns if column.name not in named and not _is_optional_column(column)]
    if rows and lacking:
        raise ValueError(f"{table.name} has no {lacking[0]}")
    for number, row in enumerate(rows, 1):
        if set(row) != named:
            raise ValueError(f"row {number} of {table.name} has other columns than the first one")
        for column in table.columns:
            value = row.get(column.name)
            if value is None:
                if column.name in row and not column.nullable:
                    raise ValueError(f"row {number} of {table.name} has no {column.name}")
            elif not _fits_column(column.type, value):
                raise ValueError(f"row {number} of {table.name} has {str(value)[:40]!r} as its {column.name}")


def _is_optional_column(column: Column[Any]) -> bool:
    """Return whether a row may lack the column: older versions did not have every one."""
    return column.nullable or column.default is not None or column.server_default is not None


def _fits_column(kind: TypeEngine[Any], value: Any) -> bool:
    if isinstance(kind, Text):
        longest = getattr(kind.impl, "length", None) or math.inf
        return isinstance(value, str) and len(value) <= longest and _is_text(value)
    if isinstance(kind, UtcDateTime):
        return isinstance(value, datetime)
    if isinstance(kind, Boolean):
        return isinstance(value, bool)
    if isinstance(kind, Integer):
        most = LARGEST_BIG if isinstance(kind, BigInteger) else LARGEST
        # In Python True is an int; in PostgreSQL a boolean is none.
        return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most
    if isinstance(kind, Float):
        return isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(kind, JSON):
        return isinstance(value, dict | list) and _is_json_value(value)
    return False


def _is_text(value: str) -> bool:
    """Return whether every database can hold a text: it has no U+0000 and no lone surrogate."""
    return "\0" not in value and not any("\ud800" <= character <= "\udfff" for character in value)


def _is_json_value(value: Any) -> bool:
    """Return whether a value survives a round trip through JSON."""
    # A list instead of recursion: a hostile file may nest deeper than Python's stack.
    pending = [value]
    while pending:
        part = pending.pop()
        if isinstance(part, dict):
            pending += [*part.keys(), *part.values()]
        elif isinstance(part, list):
            pending += part
        elif isinstance(part, str):
            if not _is_text(part):
                return False
        elif isinstance(part, float) and not math.isfinite(part):
            return False
    return True


AT_ONCE = 200
BUNDLE_TABLES: tuple[tuple[Any, Any], ...] = (
    (ResourceRow, ResourceRow.id),
    (DependencyRow, DependencyRow.dependent_id),
    (ObjectRow, ObjectRow.resource_id),
    (JobRow, JobRow.resource_id),
)
"""Tables of a bundle, each with the column that holds the id of a resource."""
TABLES = (*(table for table, _ in BUNDLE_TABLES), JobEventRow)
_Row = dict[str, Any]
_ID = re.compile("([a-z]{3})_[0-9a-hjkmnp-tv-z]{26}")
_KEY = re.compile("[0-9a-f]{64}")
_MEDIA_TYPE = re.compile(r"[\w.+-]+/[\w.+-]+(; ?[\w-]+=[\w.-]+)*", re.ASCII)
EVENTS = frozenset({"state", "progress"})
"""Names of events that a job may have."""
MAX_FILES = 100_000
"""Upper limit for the files of a bundle: a robot has a few for each recording and each model."""


def export_robot(database: Database, objects: ObjectStore, robot_id: str, target: Path) -> ArchiveSize:
    """Write the bundle of a robot into a file, which appears once it is complete."""
    bundle = RobotBundle(database, objects, robot_id)
    unfinished = target.with_name(target.name + ".part")
    try:
        with unfinished.open("wb") as file:
            file.writelines(bundle.stream())
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)
    return bundle.amount


class RobotBundle:
    """Bundle of a robot and of all resources that depend on it, except for those whose job has not ended."""

    def __init__(self, database: Database, objects: ObjectStore, robot_id: str) -> None:
        self._objects = objects
        self._robot_id = robot_id
        # One snapshot, so that no row refers to one that was deleted in between.
        with database.open_snapshot() as connection:
            if connection.execute(select(ResourceRow.kind).where(ResourceRow.id == robot_id)).scalar() != "robot":
                raise DynidentError(f"there is no robot {robot_id!r}", title="Unknown resource")
            ids = _list_bundle_ids(connection, robot_id)
            self._rows: dict[Any, list[Any]] = {
                table: list(_select_rows(connection, table, column, ids)) for table, column in BUNDLE_TABLES
            }
            jobs = [row["id"] for row in self._rows[JobRow]]
            self._rows[JobEventRow] = list(_select_rows(connection, JobEventRow, JobEventRow.job_id, jobs))
            self._revision = get_revision(connection)
        self._sizes = {row["key"]: row["size"] for row in self._rows[ObjectRow]}

    @property
    def amount(self) -> ArchiveSize:
        """Numbers of rows, objects and bytes in the bundle."""
        return ArchiveSize(sum(map(len, self._rows.values())), len(self._sizes), sum(self._sizes.values()))

    def stream(self) -> Iterator[bytes]:
        """Yield the ZIP piece by piece, so that a slow reader does not keep it in memory."""
        pieces = _StreamedFile()
        with zipfile.ZipFile(pieces, "w", zipfile.ZIP_STORED) as zipped:
            files = ArchiveZip(zipped)
            counts = {row.__tablename__: write_rows(files, row.__tablename__, self._rows[row]) for row in self._rows}
            yield pieces.take()
            for key in self._sizes:
                # The store compares what it gives with its hash.
                with files.write(f"objects/{key}") as file:
                    for chunk in self._objects.stream(key):
                        file.write(chunk)
                        yield pieces.take()
            write_manifest(files, "robot", self._revision, counts, self._robot_id)
        yield pieces.take()


class _StreamedFile(io.RawIOBase):
    """Write-only file whose content is taken out while it is written."""

    def __init__(self) -> None:
        self._written: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, content: Any) -> int:
        self._written.append(bytes(content))
        return len(content)

    def take(self) -> bytes:
        """Return the bytes that were written since the last call."""
        written, self._written = b"".join(self._written), []
        return written


def import_robot(
    database: Database, objects: ObjectStore, source: Path, scratch: Path, look_at: Callable[[Resource], object]
) -> tuple[str, ArchiveSize]:
    """Read the bundle of a robot. Resources keep their ids; those that exist already are left as they are.

    Return its id, and what was imported. `look_at` is called with each resource, and raises if this service could not
    show it. Refuse an archive that is no bundle, was modified, or holds anything that a service would not have written;
    nothing is imported then.
    """
    with open_archive_for_reading(source, MAX_FILES) as files:
        with database.engine.connect() as connection:
            robot = str(read_manifest(files, "robot", list_revisions(connection))["subject"])
            rows: dict[Any, list[_Row]] = {table: list(read_rows(files, get_table(table))) for table in TABLES}
            _check_bundle(files, rows, robot, look_at)
            known = {
                row["id"] for row in _select_rows(connection, ResourceRow, ResourceRow.id, _list_ids(rows[ResourceRow]))
            }
        new = {row["id"] for row in rows[ResourceRow]} - known
        keys = {row["key"] for row in rows[ObjectRow] if row["resource_id"] in new}
        with database.write() as session:
            # Before the objects are put: a process that is cut off in between leaves none without an owner or a
            # tombstone.
            raise_tombstones(session, keys)
        size = sum(put_object(files, objects, key, scratch) for key in sorted(keys))
        owned = [OwnedObject(row["role"], row["key"], row["size"], "") for row in rows[ObjectRow] if row["key"] in keys]
        try:
            with database.write() as session:
                lock_objects(session, objects, owned)
                number = _insert_new(session.connection(), rows, new)
        except (IntegrityError, DataError) as error:
            raise make_archive_error(
                f"it does not fit the data that are stored here: {describe_error(error)}"
            ) from error
    return robot, ArchiveSize(number, len(keys), size)


def _list_bundle_ids(connection: Connection, robot_id: str) -> list[str]:
    """Return the ids of a robot, of all that depends on it, and of what these need.

    Resources whose job has not ended are left out, with all that depends on them.
    """
    pairs = connection.execute(select(DependencyRow.dependent_id, DependencyRow.on_id)).all()
    unfinished: set[Any] = set(
        connection.execute(select(JobRow.resource_id).where(JobRow.state.not_in(FINAL))).scalars()
    )
    resting: dict[str, list[str]] = {}
    needed: dict[str, list[str]] = {}
    for dependent, on in pairs:
        resting.setdefault(on, []).append(dependent)
        needed.setdefault(dependent, []).append(on)
    # A resource whose job has not ended cannot be exported, and neither can anything that depends on it.
    unfinished = _find_reachable(unfinished, resting)
    family = _find_reachable({robot_id}, resting) - unfinished
    return sorted(_find_reachable(family, needed))


def _find_reachable(first: set[Any], next_of: dict[str, list[str]]) -> set[str]:
    """Return the nodes that are reachable from `first`."""
    reached, pending = set(first), list(first)
    while pending:
        for neighbour in next_of.get(pending.pop(), ()):
            if neighbour not in reached:
                reached.add(neighbour)
                pending.append(neighbour)
    return reached


def _select_rows(connection: Connection, row: Any, column: Any, ids: list[str]) -> Iterator[_Row]:
    for start in range(0, len(ids), AT_ONCE):
        query = select(row.__table__).where(column.in_(ids[start : start + AT_ONCE]))
        for values in connection.execute(query).mappings():
            # Keys are of one service: another one has others, perhaps by the same names.
            yield {name: value for name, value in values.items() if name != "owner"}


def _list_ids(rows: list[_Row]) -> list[str]:
    return [str(row["id"]) for row in rows]


def _check_bundle(
    files: ArchiveFiles, rows: dict[Any, list[_Row]], robot: str, look_at: Callable[[Resource], object]
) -> None:
    """Raise DynidentError if the rows are not what a service would have written."""
    try:
        for table, several in rows.items():
            check_rows(table.__table__, several)
    except ValueError as error:
        raise make_archive_error(str(error)) from error
    ids = set(_list_ids(rows[ResourceRow]))
    jobs = set(_list_ids(rows[JobRow]))
    for row in rows[ResourceRow]:
        if row["kind"] not in get_args(Kind) or not _is_id(row["id"], row["kind"]):
            raise make_archive_error(f"{row['id']!r} is not an id of a {row['kind']}")
    # The archive may come from anybody. Ids are unique, every reference has its target, and only jobs that ended come
    # in: a queued one would run a function that a stranger chose.
    sound = (
        len(ids) == len(rows[ResourceRow])
        and len(jobs) == len(rows[JobRow]) == len({row["resource_id"] for row in rows[JobRow]})
        and all({row["dependent_id"], row["on_id"]} <= ids for row in rows[DependencyRow])
        and all(row["resource_id"] in ids for row in rows[ObjectRow])
        and all(
            row["resource_id"] in ids and row["state"] in FINAL and _is_id(row["id"], "job") for row in rows[JobRow]
        )
        and all(row["job_id"] in jobs and row["event"] in EVENTS for row in rows[JobEventRow])
    )
    if not sound:
        raise make_archive_error(
            "it refers to a resource that it does not contain, that it contains twice, or that is not computed"
        )
    if (robot, "robot") not in {(row["id"], row["kind"]) for row in rows[ResourceRow]}:
        raise make_archive_error("it contains no robot")
    _check_objects(files, rows[ObjectRow])
    _check_order(rows[DependencyRow])
    for resource in _build_resources(rows):
        try:
            look_at(resource)
        except Exception as error:
            raise make_archive_error(
                f"the {resource.kind} {resource.id} is not valid: {describe_error(error)}"
            ) from error


def _is_id(identifier: str, kind: str) -> bool:
    match = _ID.fullmatch(identifier)
    return match is not None and KINDS.get(match[1]) == kind


def _check_objects(files: ArchiveFiles, rows: list[_Row]) -> None:
    for row in rows:
        if not _KEY.fullmatch(row["key"]) or not _MEDIA_TYPE.fullmatch(row["media_type"]):
            raise make_archive_error(f"{row['key'][:80]!r} of the type {row['media_type'][:80]!r} is not a file")
        size = files.get_size(f"objects/{row['key']}")
        if size != row["size"]:
            raise make_archive_error(f"the file {row['key']} has {size} bytes instead of {row['size']}")


def _check_order(rows: list[_Row]) -> None:
    """Raise DynidentError if dependencies form a cycle: code that follows them would never end."""
    on: dict[str, set[str]] = {}
    for row in rows:
        on.setdefault(row["dependent_id"], set()).add(row["on_id"])
    try:
        TopologicalSorter(on).prepare()
    except CycleError as error:
        raise make_archive_error(f"{error.args[1][0]} depends on itself") from error


def _build_resources(rows: dict[Any, list[_Row]]) -> Iterator[Resource]:
    """Yield the resources as the service would read them from its tables."""
    needs: dict[str, list[tuple[str, str]]] = {}
    owned: dict[str, dict[str, OwnedObject]] = {}
    for row in rows[DependencyRow]:
        needs.setdefault(row["dependent_id"], []).append((row["role"], row["on_id"]))
    for row in rows[ObjectRow]:
        owned_object = OwnedObject(row["role"], row["key"], row["size"], row["media_type"])
        owned.setdefault(row["resource_id"], {})[row["role"]] = owned_object
    jobs = {row["resource_id"]: row for row in rows[JobRow]}
    for row in rows[ResourceRow]:
        job = jobs.get(row["id"], {})
        columns = [*(row.get(name) for name in RESOURCE_COLUMNS), *(job.get(name) for name in JOB_COLUMNS)]
        yield to_resource(columns, needs.get(row["id"], ()), owned.get(row["id"], {}))


def _insert_new(connection: Connection, rows: dict[Any, list[_Row]], new: set[str]) -> int:
    number = 0
    owner = {ResourceRow: "id", DependencyRow: "dependent_id", ObjectRow: "resource_id", JobRow: "resource_id"}
    for row, name in owner.items():
        number += _insert_rows(connection, row.__table__, [values for values in rows[row] if values[name] in new])
    jobs = {job["id"] for job in rows[JobRow] if job["resource_id"] in new}
    # Event ids are of the other service. The order is kept, and new ids are given here.
    events = sorted(
        (event for event in rows[JobEventRow] if event["job_id"] in jobs), key=lambda event: int(event["id"])
    )
    return number + _insert_rows(connection, JobEventRow.__table__, [{**event, "id": None} for event in events])


def _insert_rows(connection: Connection, table: Any, rows: list[_Row]) -> int:
    # An owner is a key of another service, whatever the archive says.
    inserts = [{k: value for k, value in row.items() if k != "owner" and (k, value) != ("id", None)} for row in rows]
    if inserts:
        connection.execute(insert(table), inserts)
    return len(inserts)
