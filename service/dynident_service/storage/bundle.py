"""The bundle of one robot: its description, recordings, models, ladders, diagnoses and reports, for another service."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

from sqlalchemy import Connection, insert, select

from dynident.errors import DynidentError
from dynident_service.storage.archive import (
    Row,
    read_manifest,
    read_rows,
    write_manifest,
    write_object,
    write_rows,
)
from dynident_service.storage.backup import (
    Amount,
    files_to_read,
    files_to_write,
    known_revisions,
    put_object,
    revision_of,
)
from dynident_service.storage.database import Database
from dynident_service.storage.identifiers import PREFIXES
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.records import FINAL, Kind, Owned
from dynident_service.storage.tables import DependencyRow, JobEventRow, JobRow, ObjectRow, ResourceRow
from dynident_service.storage.tombstones import announce, hold

AT_ONCE = 200
PARTS: tuple[tuple[Any, Any], ...] = (
    (ResourceRow, ResourceRow.id),
    (DependencyRow, DependencyRow.dependent_id),
    (ObjectRow, ObjectRow.resource_id),
    (JobRow, JobRow.resource_id),
)
_ID = re.compile("([a-z]{3})_[0-9a-hjkmnp-tv-z]{26}")
_KEY = re.compile("[0-9a-f]{64}")
KINDS = {prefix: kind for kind, prefix in PREFIXES.items()}


def export_robot(database: Database, objects: ObjectStore, robot_id: str, target: Path) -> Amount:
    """Write a robot and all that rests on it into an archive; what is still being computed is left out."""
    with files_to_write(target) as files, database.engine.connect() as connection, connection.begin():
        if connection.execute(select(ResourceRow.kind).where(ResourceRow.id == robot_id)).scalar() != "robot":
            raise DynidentError(f"there is no robot {robot_id!r}", title="Unknown resource")
        ids = _family(connection, robot_id)
        parts = {table: list(_of(connection, table, column, ids)) for table, column in PARTS}
        jobs = [row["id"] for row in parts[JobRow]]
        parts[JobEventRow] = list(_of(connection, JobEventRow, JobEventRow.job_id, jobs))
        counts = {row.__tablename__: write_rows(files, row.__tablename__, parts[row]) for row in parts}
        owned = {row["key"]: row["size"] for row in parts[ObjectRow]}
        for key in owned:
            write_object(files, key, objects.stream(key))
        write_manifest(files, "robot", revision_of(connection), counts, robot_id)
    return Amount(sum(counts.values()), len(owned), sum(owned.values()))


def import_robot(database: Database, objects: ObjectStore, source: Path, scratch: Path) -> tuple[str, Amount]:
    """Read the bundle of a robot; tells the robot's id, which stays as it was. What is there already is left alone.

    Raises DynidentError where the archive is none of a robot, was changed, or names what it does not hold.
    """
    with files_to_read(source) as files:
        with database.engine.connect() as connection:
            robot = str(read_manifest(files, "robot", known_revisions(connection))["subject"])
            rows = {table: list(read_rows(files, table.__table__)) for table, _ in PARTS}
            rows[JobEventRow] = list(read_rows(files, JobEventRow.__table__))
            known = {row["id"] for row in _of(connection, ResourceRow, ResourceRow.id, _ids(rows[ResourceRow]))}
        _check(rows, robot)
        new = {row["id"] for row in rows[ResourceRow]} - known
        keys = {row["key"] for row in rows[ObjectRow] if row["resource_id"] in new}
        with database.write() as session:
            announce(session, keys)
        size = sum(put_object(files, objects, key, scratch) for key in sorted(keys))
        owned = [Owned(row["role"], row["key"], row["size"], "") for row in rows[ObjectRow] if row["key"] in keys]
        with database.write() as session:
            hold(session, objects, owned)
            number = _store(session.connection(), rows, new)
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


def _of(connection: Connection, row: Any, column: Any, ids: list[str]) -> Iterator[Row]:
    for start in range(0, len(ids), AT_ONCE):
        query = select(row.__table__).where(column.in_(ids[start : start + AT_ONCE]))
        for one in connection.execute(query).mappings():
            # Keys are of one service: another one has others, perhaps by the same names.
            yield {name: value for name, value in one.items() if name != "owner"}


def _ids(rows: list[Row]) -> list[str]:
    return [str(row["id"]) for row in rows]


def _check(rows: dict[Any, list[Row]], robot: str) -> None:
    """An archive from elsewhere says nothing that a service itself would not have written."""
    ids = set(_ids(rows[ResourceRow]))
    jobs = set(_ids(rows[JobRow]))
    for row in rows[ResourceRow]:
        found = _ID.fullmatch(str(row["id"]))
        if row["kind"] not in get_args(Kind) or found is None or KINDS.get(found[1]) != row["kind"]:
            raise _unusable(f"{row['id']!r} is no id of a {row['kind']}")
    sound = (
        all({row["dependent_id"], row["on_id"]} <= ids for row in rows[DependencyRow])
        and all(row["resource_id"] in ids and _KEY.fullmatch(row["key"]) for row in rows[ObjectRow])
        and all(row["resource_id"] in ids and row["state"] in FINAL for row in rows[JobRow])
        and all(row["job_id"] in jobs for row in rows[JobEventRow])
    )
    if not sound:
        raise _unusable("it names what it does not hold, or what has not been computed")
    if (robot, "robot") not in {(row["id"], row["kind"]) for row in rows[ResourceRow]}:
        raise _unusable("it holds no robot")


def _store(connection: Connection, rows: dict[Any, list[Row]], new: set[str]) -> int:
    number = 0
    owner = {ResourceRow: "id", DependencyRow: "dependent_id", ObjectRow: "resource_id", JobRow: "resource_id"}
    for row, name in owner.items():
        number += _add(connection, row.__table__, [one for one in rows[row] if one[name] in new])
    jobs = {one["id"] for one in rows[JobRow] if one["resource_id"] in new}
    events = sorted((one for one in rows[JobEventRow] if one["job_id"] in jobs), key=lambda one: int(one["id"]))
    return number + _add(connection, JobEventRow.__table__, [{**one, "id": None} for one in events])


def _add(connection: Connection, table: Any, rows: list[Row]) -> int:
    # An owner is a key of another service, whatever the archive says.
    kept = [{k: value for k, value in row.items() if k != "owner" and (k, value) != ("id", None)} for row in rows]
    if kept:
        connection.execute(insert(table), kept)
    return len(kept)


def _unusable(detail: str) -> DynidentError:
    return DynidentError(f"the bundle cannot be used: {detail}", title="Unusable archive")
