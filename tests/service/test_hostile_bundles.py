"""Bundles of robots that were made by a hostile hand: refused with the reason, and nothing of them is imported."""

from __future__ import annotations

import json
import os
import struct
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS
from sqlalchemy import func, select
from support.measurement_uploads import as_csv, sound, upload

from dynident.errors import DynidentError
from dynident_service.readability_checks import check_stored_resource
from dynident_service.storage import robot_bundle as bundle_module
from dynident_service.storage.database import Database, migrate
from dynident_service.storage.database_tables import ResourceRow
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.robot_bundle import export_robot, import_robot
from dynident_service.storage_and_engine import Services

Content = dict[str, bytes]
Row = dict[str, Any]


@pytest.fixture(scope="module")
def robot_id(client: TestClient) -> str:
    described = {"name": "arm", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    robot = client.post("/v1/robots", json=described).json()
    first = upload(client, robot, as_csv(sound(400))).json()
    assert client.post(f"/v1/measurements/{first['id']}/revisions", json={"windows": [[0.5, 3.0]]}).status_code == 201
    made = client.post("/v1/identifications", json={"robot_id": robot["id"], "measurement_ids": [first["id"]]}).json()
    assert client.post(f"/v1/jobs/{made['job_id']}/cancel").status_code == 200
    for event in client.get(f"/v1/jobs/{made['job_id']}/events").text.splitlines():
        assert event is not None
    return str(robot["id"])


@pytest.fixture
def content(client: TestClient, services: Services, robot_id: str, tmp_path: Path) -> Content:
    export_robot(services.database, services.objects, robot_id, tmp_path / "whole.zip")
    with zipfile.ZipFile(tmp_path / "whole.zip") as whole:
        return {name: whole.read(name) for name in whole.namelist()}


@dataclass
class Elsewhere:
    """Another service, empty so far."""

    database: Database
    objects: ObjectStore
    folder: Path

    def reads(self, content: Content, packed: int = zipfile.ZIP_STORED) -> str:
        file = self.folder / "bundle.zip"
        with zipfile.ZipFile(file, "w", packed) as written:
            for name, put in content.items():
                written.writestr(name, put)
        return self.reads_file(file)

    def reads_file(self, file: Path) -> str:
        return import_robot(self.database, self.objects, file, self.folder / "scratch", check_stored_resource)[0]

    def refuses(self, content: Content, word: str) -> None:
        with pytest.raises(DynidentError, match=word) as refused:
            self.reads(content)
        assert refused.value.title == "Unusable archive"
        assert self.is_empty()

    def is_empty(self) -> bool:
        with self.database.read() as session:
            return session.scalar(select(func.count()).select_from(ResourceRow)) == 0


# Most is refused before anything reaches the database.
@pytest.fixture(params=["sqlite", pytest.param("postgresql", marks=(pytest.mark.slow, pytest.mark.sweep))])
def elsewhere(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Elsewhere]:
    url = f"sqlite:///{tmp_path / 'other.sqlite3'}"
    if request.param == "postgresql":
        url = request.getfixturevalue("postgresql")
    database = Database(url)
    migrate(database)
    assert Elsewhere(database, ObjectStore((tmp_path / "other").as_uri(), tmp_path / "cache"), tmp_path).is_empty()
    yield Elsewhere(database, ObjectStore((tmp_path / "other").as_uri(), tmp_path / "cache"), tmp_path)
    database.close()


def changed(content: Content, table: str, change: Callable[[Row], Row], number: int = 0) -> Content:
    """The same with one row of a table changed."""
    name = f"tables/{table}.jsonl"
    lines = content[name].splitlines()
    lines[number] = json.dumps(change(json.loads(lines[number]))).encode()
    return {**content, name: b"\n".join(lines) + b"\n"}


def test_a_bundle_is_read_also_packed_anew_and_twice(elsewhere: Elsewhere, content: Content, robot_id: str) -> None:
    if not elsewhere.database.is_sqlite:
        pytest.skip("one server for all tests: nothing may stay")
    for packed in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        assert elsewhere.reads(content, packed) == robot_id


HOSTILE: dict[str, tuple[str, dict[str, Any], str]] = {
    "an id that leads out": ("resources", {"id": "../../etc/passwd"}, "is not an id"),
    "an id of another kind": ("resources", {"id": "job_01m8a537spwfmtj6b3tgq6hy3d"}, "is not an id"),
    "a kind that there is not": ("resources", {"kind": "shell"}, "is not an id"),
    "a name that is a list": ("resources", {"name": ["a"]}, "as its name"),
    "a name without an end": ("resources", {"name": "a" * 201}, "as its name"),
    "a name with a NUL": ("resources", {"name": "a\0b"}, "as its name"),
    "half a character": ("resources", {"request": {"name": "\ud800"}}, "as its request"),
    "a number that is none": ("resources", {"request": {"name": float("nan")}}, "as its request"),
    "a request of nothing": ("resources", {"request": {}}, "is not valid"),
    "a request that is a list": ("resources", {"request": [1]}, "is not valid"),
    "no request": ("resources", {"request": None}, "has no request"),
    "a result that is a list": ("resources", {"result": [1]}, "is not valid"),
    "a time that is none": ("resources", {"created_at": "yesterday"}, "row 1 of resources is not valid"),
    "a time that is a number": ("resources", {"created_at": 5}, "row 1 of resources is not valid"),
    "tags that are numbers": ("resources", {"tags": [1]}, "is not valid"),
    "an archive of words": ("resources", {"archived": "yes"}, "as its archived"),
    "a file that leads out": ("objects", {"key": "../../../../etc/passwd"}, "is not a file"),
    "a file that is not there": ("objects", {"key": "0" * 64}, "has None bytes"),
    "a size that lies": ("objects", {"size": 3}, "instead of 3"),
    "a size beyond all disks": ("objects", {"size": 10**30}, "as its size"),
    "a size below nothing": ("objects", {"size": -1}, "as its size"),
    "a type that ends the header": ("objects", {"media_type": "text/csv\r\nSet-Cookie: a=b"}, "is not a file"),
    "a role without an end": ("objects", {"role": "r" * 21}, "as its role"),
    "a file of nobody": ("objects", {"resource_id": "rob_01m8a537spwfmtj6b3tgq6hy3d"}, "does not contain"),
    "a recording without its file": ("objects", {"role": "other"}, "is not valid: ValueError: it has no recording"),
    "something that rests on nothing": (
        "dependencies",
        {"on_id": "rob_01m8a537spwfmtj6b3tgq6hy3d"},
        "does not contain",
    ),
    "something that rests on a robot twice": ("dependencies", {"role": None}, "has no role"),
    "a job that is to be run": ("jobs", {"state": "queued"}, "is not computed"),
    "a job that is a path": ("jobs", {"id": "/tmp/x"}, "does not contain"),
    "a job of a kind that there is not": ("jobs", {"kind": "shell"}, "is not valid"),
    "an error that is none": ("jobs", {"error": {"status": "bad"}}, "is not valid"),
    "an endless number": ("jobs", {"attempt": 10**12}, "as its attempt"),
    "a share of a word": ("jobs", {"fraction": "half"}, "as its fraction"),
    "an event that there is not": ("job_events", {"event": "shell"}, "does not contain"),
    "an event of nobody": ("job_events", {"job_id": "job_01m8a537spwfmtj6b3tgq6hy3d"}, "does not contain"),
}


@pytest.mark.parametrize("hostile", HOSTILE)
def test_what_no_service_would_have_written_is_refused(elsewhere: Elsewhere, content: Content, hostile: str) -> None:
    table, change, word = HOSTILE[hostile]
    number = recording_of(content) if hostile == "a recording without its file" else 0
    elsewhere.refuses(changed(content, table, lambda row: {**row, **change}, number), word)


@pytest.mark.parametrize(("table", "column"), [("resources", "archived"), ("jobs", "losses"), ("job_events", "id")])
@pytest.mark.parametrize("everywhere", [False, True])
def test_a_column_that_is_left_out_is_refused_unless_older_versions_had_none(
    elsewhere: Elsewhere, content: Content, table: str, column: str, everywhere: bool
) -> None:
    name = f"tables/{table}.jsonl"
    rows = [json.loads(line) for line in content[name].splitlines()]
    for row in rows if everywhere else rows[1:]:
        del row[column]
    left_out = {**content, name: b"".join(json.dumps(row).encode() + b"\n" for row in rows)}
    if everywhere and column != "id":
        if elsewhere.database.is_sqlite:  # one server for all tests: nothing may stay
            assert elsewhere.reads(left_out)
    elif len(rows) > 1:
        elsewhere.refuses(left_out, "has no id" if everywhere else "other columns")


def recording_of(content: Content) -> int:
    rows = [json.loads(line) for line in content["tables/objects.jsonl"].splitlines()]
    return next(k for k, row in enumerate(rows) if row["role"] == "recording")


def test_what_rests_on_itself_by_a_detour_is_refused(elsewhere: Elsewhere, content: Content) -> None:
    row = json.loads(content["tables/dependencies.jsonl"].splitlines()[0])
    back = {"dependent_id": row["on_id"], "on_id": row["dependent_id"], "role": "parent"}
    name = "tables/dependencies.jsonl"
    elsewhere.refuses({**content, name: content[name] + json.dumps(back).encode()}, "depends on itself")


@pytest.mark.parametrize("table", ["resources", "jobs", "objects", "dependencies"])
def test_what_is_there_twice_is_refused(elsewhere: Elsewhere, content: Content, table: str) -> None:
    name = f"tables/{table}.jsonl"
    twice = {**content, name: content[name] + content[name].splitlines()[0] + b"\n"}
    elsewhere.refuses(twice, "twice|does not fit")


@pytest.mark.parametrize(
    "line", [b"no json", b"[1, 2]", b"5", b"\xff\xfe", b'{"id": ' * 100_000, b"9" * 5000, b'{"size": 1e999}']
)
@pytest.mark.parametrize("table", ["resources", "job_events"])
def test_lines_that_are_no_rows_are_refused(elsewhere: Elsewhere, content: Content, table: str, line: bytes) -> None:
    name = f"tables/{table}.jsonl"
    elsewhere.refuses({**content, name: content[name] + line + b"\n"}, rf"of {table}")


def test_a_line_without_an_end_is_refused_before_it_is_in_memory(
    elsewhere: Elsewhere, content: Content, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dynident_service.storage.archive_format.MAX_ROW_BYTES", 100_000)
    name = "tables/job_events.jsonl"
    endless = content[name] + b'{"data": "' + b"a" * 200_000
    elsewhere.refuses({**content, name: endless}, r"row \d of job_events is not valid \(ValueError\)")


@pytest.mark.parametrize("manifest", [b"", b"[]", b"null", b"{}", b"\xff", b'{"dynident_archive": 1}', b"[" * 100_000])
def test_a_manifest_that_is_none_is_refused(elsewhere: Elsewhere, content: Content, manifest: bytes) -> None:
    elsewhere.refuses({**content, "manifest.json": manifest}, "manifest|written by")


def test_a_hash_that_does_not_fit_is_refused_and_none_of_its_rows_is_there(
    elsewhere: Elsewhere, content: Content
) -> None:
    for name in [one for one in content if one.startswith("objects/")]:
        put = content[name]
        elsewhere.refuses({**content, name: put[:-1] + bytes([put[-1] ^ 1])}, "damaged")


def test_files_that_lead_out_are_never_looked_at(elsewhere: Elsewhere, content: Content, robot_id: str) -> None:
    if not elsewhere.database.is_sqlite:
        pytest.skip("one server for all tests: nothing may stay")
    out = {"../outside": b"x", "/tmp/outside-of-all": b"x", "objects/../../outside": b"x"}
    assert elsewhere.reads({**content, **out}) == robot_id
    assert not (elsewhere.folder.parent / "outside").exists()
    assert not Path("/tmp/outside-of-all").exists()


def test_a_bundle_that_would_fill_the_disk_is_refused_before_anything_is_unpacked(
    elsewhere: Elsewhere, content: Content
) -> None:
    file = elsewhere.folder / "bomb.zip"
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as written:
        for name, put in content.items():
            written.writestr(name, put)
        with written.open("objects/" + "0" * 64, "w", force_zip64=True) as zeros:
            for _ in range(100):
                zeros.write(bytes(1_000_000))
    with pytest.raises(DynidentError, match="would unpack to"):
        elsewhere.reads_file(file)
    assert not (elsewhere.folder / "scratch").exists()


def test_a_size_that_the_zip_itself_lies_about_is_no_way_round(elsewhere: Elsewhere, content: Content) -> None:
    file = elsewhere.folder / "liar.zip"
    key = "objects/" + json.loads(content["tables/objects.jsonl"].splitlines()[0])["key"]
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as written:
        for name, put in content.items():
            written.writestr(name, put if name != key else bytes(5_000_000))
        place = written.infolist()[[one.filename for one in written.infolist()].index(key)]
        place.file_size = len(content[key])
    with pytest.raises(DynidentError, match=r"damaged|has"):
        elsewhere.reads_file(file)
    assert elsewhere.is_empty()


@pytest.mark.parametrize("longer", [False, True])
def test_a_bundle_of_very_many_files_is_refused_before_they_are_listed(
    elsewhere: Elsewhere, content: Content, monkeypatch: pytest.MonkeyPatch, longer: bool
) -> None:
    monkeypatch.setattr(bundle_module, "MAX_FILES", 50)
    file = elsewhere.folder / "many.zip"
    if longer:
        monkeypatch.setattr(zipfile, "ZIP_FILECOUNT_LIMIT", 10)  # what ZIPs of more than 65,535 files have
    with zipfile.ZipFile(file, "w") as written:
        for name, put in (content | {f"more/{k}": b"" for k in range(300)}).items():
            written.writestr(name, put)
    monkeypatch.setattr(zipfile, "ZipFile", None)
    with pytest.raises(DynidentError, match="has at most 50 files"):
        elsewhere.reads_file(file)


@pytest.mark.parametrize("kind", ["locked", "cut", "packed as nobody knows", "empty", "no archive", "a folder's"])
def test_what_cannot_be_unpacked_is_refused(elsewhere: Elsewhere, content: Content, kind: str) -> None:
    file = elsewhere.folder / "odd.zip"
    with zipfile.ZipFile(file, "w") as written:
        for name, put in content.items():
            written.writestr(name, put)
    whole = bytearray(file.read_bytes())
    first = whole.index(b"PK\1\2")
    if kind == "locked":
        for at in places(whole, b"PK\1\2"):
            whole[at + 8] |= 1
    elif kind == "cut":
        del whole[first - 200 : first]
    elif kind == "packed as nobody knows":
        for at in places(whole, b"PK\1\2"):
            whole[at + 10 : at + 12] = struct.pack("<H", 99)
    elif kind == "empty":
        whole.clear()
    else:
        whole[:] = os.urandom(1000)
    file.write_bytes(whole)
    if kind == "a folder's":
        file.unlink()
        file.mkdir()
    with pytest.raises(DynidentError) as refused:
        elsewhere.reads_file(file)
    assert refused.value.title == "Unusable archive"
    assert elsewhere.is_empty()


def places(content: bytes | bytearray, mark: bytes) -> Iterator[int]:
    at = content.find(mark)
    while at >= 0:
        yield at
        at = content.find(mark, at + 4)
