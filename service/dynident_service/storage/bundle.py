"""The bundle of one robot: its description, recordings, models, ladders, diagnoses and reports, for another service."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Callable, Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any, get_args

from sqlalchemy import Connection, insert, select
from sqlalchemy.exc import DataError, IntegrityError

from dynident.errors import DynidentError
from dynident_service.storage.archive import (
    Files,
    Zipped,
    read_manifest,
    read_rows,
    unusable,
    write_manifest,
    write_rows,
)
from dynident_service.storage.backup import (
    Amount,
    files_to_read,
    known_revisions,
    put_object,
    revision_of,
)
from dynident_service.storage.checking import check_rows
from dynident_service.storage.database import Database
from dynident_service.storage.identifiers import KINDS
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.patience import reason_of
from dynident_service.storage.reading import OF_JOBS, OF_RESOURCES, as_resource
from dynident_service.storage.records import FINAL, Kind, Owned, Resource
from dynident_service.storage.tables import DependencyRow, JobEventRow, JobRow, ObjectRow, ResourceRow, table_of
from dynident_service.storage.tombstones import announce, hold

AT_ONCE = 200
PARTS: tuple[tuple[Any, Any], ...] = (
    (ResourceRow, ResourceRow.id),
    (DependencyRow, DependencyRow.dependent_id),
    (ObjectRow, ObjectRow.resource_id),
    (JobRow, JobRow.resource_id),
)
TABLES = (*(table for table, _ in PARTS), JobEventRow)
_Row = dict[str, Any]
_ID = re.compile("([a-z]{3})_[0-9a-hjkmnp-tv-z]{26}")
_KEY = re.compile("[0-9a-f]{64}")
_MEDIA_TYPE = re.compile(r"[\w.+-]+/[\w.+-]+(; ?[\w-]+=[\w.-]+)*", re.ASCII)
EVENTS = frozenset({"state", "progress"})
MOST_FILES = 100_000
"""A robot has a few for each recording and each model."""


def export_robot(database: Database, objects: ObjectStore, robot_id: str, target: Path) -> Amount:
    """Write the archive of a robot into a file, which is there once it is whole."""
    bundle = Bundle(database, objects, robot_id)
    unfinished = target.with_name(target.name + ".part")
    try:
        with unfinished.open("wb") as file:
            file.writelines(bundle.stream())
        unfinished.replace(target)
    finally:
        unfinished.unlink(missing_ok=True)
    return bundle.amount


class Bundle:
    """The archive of a robot and of all that rests on it, but for what is still being computed.

    Raises DynidentError where there is no such robot.
    """

    def __init__(self, database: Database, objects: ObjectStore, robot_id: str) -> None:
        self._objects = objects
        self._robot_id = robot_id
        with database.one_moment() as connection:
            if connection.execute(select(ResourceRow.kind).where(ResourceRow.id == robot_id)).scalar() != "robot":
                raise DynidentError(f"there is no robot {robot_id!r}", title="Unknown resource")
            ids = _family(connection, robot_id)
            self._rows: dict[Any, list[Any]] = {
                table: list(_of(connection, table, column, ids)) for table, column in PARTS
            }
            jobs = [row["id"] for row in self._rows[JobRow]]
            self._rows[JobEventRow] = list(_of(connection, JobEventRow, JobEventRow.job_id, jobs))
            self._revision = revision_of(connection)
        self._sizes = {row["key"]: row["size"] for row in self._rows[ObjectRow]}

    @property
    def amount(self) -> Amount:
        """How much it holds."""
        return Amount(sum(map(len, self._rows.values())), len(self._sizes), sum(self._sizes.values()))

    def stream(self) -> Iterator[bytes]:
        """Give the ZIP piece by piece: nothing of it is kept for a reader who is slow."""
        pieces = _Pieces()
        with zipfile.ZipFile(pieces, "w", zipfile.ZIP_STORED) as zipped:
            files = Zipped(zipped)
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


class _Pieces(io.RawIOBase):
    """A file that is written from its beginning to its end, and read meanwhile."""

    def __init__(self) -> None:
        self._written: list[bytes] = []

    def writable(self) -> bool:
        return True

    def write(self, content: Any) -> int:
        self._written.append(bytes(content))
        return len(content)

    def take(self) -> bytes:
        """Give what was written since it was last asked."""
        written, self._written = b"".join(self._written), []
        return written


def import_robot(
    database: Database, objects: ObjectStore, source: Path, scratch: Path, look_at: Callable[[Resource], object]
) -> tuple[str, Amount]:
    """Read the bundle of a robot; tells the robot's id, which stays as it was. What is there already is left alone.

    `look_at` raises whatever it likes for a resource that this service could not show. Raises DynidentError where the
    archive is none of a robot, was changed, or holds anything that no service would have written; then nothing is
    imported.
    """
    with files_to_read(source, MOST_FILES) as files:
        with database.engine.connect() as connection:
            robot = str(read_manifest(files, "robot", known_revisions(connection))["subject"])
            rows: dict[Any, list[_Row]] = {table: list(read_rows(files, table_of(table))) for table in TABLES}
            _check(files, rows, robot, look_at)
            known = {row["id"] for row in _of(connection, ResourceRow, ResourceRow.id, _ids(rows[ResourceRow]))}
        new = {row["id"] for row in rows[ResourceRow]} - known
        keys = {row["key"] for row in rows[ObjectRow] if row["resource_id"] in new}
        with database.write() as session:
            announce(session, keys)
        size = sum(put_object(files, objects, key, scratch) for key in sorted(keys))
        owned = [Owned(row["role"], row["key"], row["size"], "") for row in rows[ObjectRow] if row["key"] in keys]
        try:
            with database.write() as session:
                hold(session, objects, owned)
                number = _store(session.connection(), rows, new)
        except (IntegrityError, DataError) as error:
            raise unusable(f"it does not go with what is stored here: {reason_of(error)}") from error
    return robot, Amount(number, len(keys), size)


def _family(connection: Connection, robot_id: str) -> list[str]:
    """The robot, all that rests on it, and what these need besides; nothing whose job has not ended."""
    pairs = connection.execute(select(DependencyRow.dependent_id, DependencyRow.on_id)).all()
    unfinished: set[Any] = set(
        connection.execute(select(JobRow.resource_id).where(JobRow.state.not_in(FINAL))).scalars()
    )
    resting: dict[str, list[str]] = {}
    needed: dict[str, list[str]] = {}
    for dependent, on in pairs:
        resting.setdefault(on, []).append(dependent)
        needed.setdefault(dependent, []).append(on)
    unfinished = _closure(unfinished, resting)
    family = _closure({robot_id}, resting) - unfinished
    return sorted(_closure(family, needed))


def _closure(first: set[Any], next_of: dict[str, list[str]]) -> set[str]:
    found, left = set(first), list(first)
    while left:
        for one in next_of.get(left.pop(), ()):
            if one not in found:
                found.add(one)
                left.append(one)
    return found


def _of(connection: Connection, row: Any, column: Any, ids: list[str]) -> Iterator[_Row]:
    for start in range(0, len(ids), AT_ONCE):
        query = select(row.__table__).where(column.in_(ids[start : start + AT_ONCE]))
        for one in connection.execute(query).mappings():
            # Keys are of one service: another one has others, perhaps by the same names.
            yield {name: value for name, value in one.items() if name != "owner"}


def _ids(rows: list[_Row]) -> list[str]:
    return [str(row["id"]) for row in rows]


def _check(files: Files, rows: dict[Any, list[_Row]], robot: str, look_at: Callable[[Resource], object]) -> None:
    """An archive from elsewhere says nothing that a service itself would not have written."""
    try:
        for table, several in rows.items():
            check_rows(table.__table__, several)
    except ValueError as error:
        raise unusable(str(error)) from error
    ids = set(_ids(rows[ResourceRow]))
    jobs = set(_ids(rows[JobRow]))
    for row in rows[ResourceRow]:
        if row["kind"] not in get_args(Kind) or not _is_id(row["id"], row["kind"]):
            raise unusable(f"{row['id']!r} is no id of a {row['kind']}")
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
        raise unusable("it names what it does not hold, or twice, or what has not been computed")
    if (robot, "robot") not in {(row["id"], row["kind"]) for row in rows[ResourceRow]}:
        raise unusable("it holds no robot")
    _check_objects(files, rows[ObjectRow])
    _check_order(rows[DependencyRow])
    for one in _resources(rows):
        try:
            look_at(one)
        except Exception as error:
            raise unusable(f"the {one.kind} {one.id} is none: {reason_of(error)}") from error


def _is_id(identifier: str, kind: str) -> bool:
    found = _ID.fullmatch(identifier)
    return found is not None and KINDS.get(found[1]) == kind


def _check_objects(files: Files, rows: list[_Row]) -> None:
    for row in rows:
        if not _KEY.fullmatch(row["key"]) or not _MEDIA_TYPE.fullmatch(row["media_type"]):
            raise unusable(f"{row['key'][:80]!r} of the type {row['media_type'][:80]!r} is no file")
        found = files.size(f"objects/{row['key']}")
        if found != row["size"]:
            raise unusable(f"the file {row['key']} has {found} bytes instead of {row['size']}")


def _check_order(rows: list[_Row]) -> None:
    """Nothing rests on itself, by whatever detour: whoever follows what something rests on comes to an end."""
    on: dict[str, set[str]] = {}
    for row in rows:
        on.setdefault(row["dependent_id"], set()).add(row["on_id"])
    try:
        TopologicalSorter(on).prepare()
    except CycleError as error:
        raise unusable(f"{error.args[1][0]} rests on itself") from error


def _resources(rows: dict[Any, list[_Row]]) -> Iterator[Resource]:
    """The resources as they will be read."""
    needs: dict[str, list[tuple[str, str]]] = {}
    owned: dict[str, dict[str, Owned]] = {}
    for row in rows[DependencyRow]:
        needs.setdefault(row["dependent_id"], []).append((row["role"], row["on_id"]))
    for row in rows[ObjectRow]:
        one = Owned(row["role"], row["key"], row["size"], row["media_type"])
        owned.setdefault(row["resource_id"], {})[row["role"]] = one
    jobs = {row["resource_id"]: row for row in rows[JobRow]}
    for row in rows[ResourceRow]:
        job = jobs.get(row["id"], {})
        told = [*(row.get(name) for name in OF_RESOURCES), *(job.get(name) for name in OF_JOBS)]
        yield as_resource(told, needs.get(row["id"], ()), owned.get(row["id"], {}))


def _store(connection: Connection, rows: dict[Any, list[_Row]], new: set[str]) -> int:
    number = 0
    owner = {ResourceRow: "id", DependencyRow: "dependent_id", ObjectRow: "resource_id", JobRow: "resource_id"}
    for row, name in owner.items():
        number += _add(connection, row.__table__, [one for one in rows[row] if one[name] in new])
    jobs = {one["id"] for one in rows[JobRow] if one["resource_id"] in new}
    events = sorted((one for one in rows[JobEventRow] if one["job_id"] in jobs), key=lambda one: int(one["id"]))
    return number + _add(connection, JobEventRow.__table__, [{**one, "id": None} for one in events])


def _add(connection: Connection, table: Any, rows: list[_Row]) -> int:
    # An owner is a key of another service, whatever the archive says.
    kept = [{k: value for k, value in row.items() if k != "owner" and (k, value) != ("id", None)} for row in rows]
    if kept:
        connection.execute(insert(table), kept)
    return len(kept)
