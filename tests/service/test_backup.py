"""All that is stored survives the loss of everything, and a robot goes to another service with what belongs to it."""

from __future__ import annotations

import hashlib
import json
import shutil
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, wait_for
from sqlalchemy import select
from support.stores import Store, open_store
from typer.testing import CliRunner

from dynident.errors import DynidentError
from dynident.robot import library_table
from dynident_cli.program_and_exit_codes import app
from dynident_service.identifications import routes as identifications
from dynident_service.measurements import routes as measurements
from dynident_service.storage.backup_and_restore import back_up, list_tables, restore
from dynident_service.storage.database import migrate
from dynident_service.storage.integrity_check import check_storage
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.repository_values import NewJob
from dynident_service.storage_and_engine import Services

JOB = NewJob("report", "small_jobs:answer")
Open = Callable[[str], Store]


@pytest.fixture
def at(tmp_path: Path) -> Iterator[Open]:
    """Opens what is stored in a folder of a name."""
    opened: list[Store] = []

    def begin(name: str) -> Store:
        folder = tmp_path / name
        folder.mkdir()
        store = open_store(f"sqlite:///{folder / 'dynident.sqlite3'}", folder)
        migrate(store.database)
        opened.append(store)
        return store

    yield begin
    for store in opened:
        store.database.close()


def hashes(store: Store, *but: str) -> dict[str, str]:
    """The hash of each table and of each object."""
    found = {}
    with store.database.engine.connect() as connection:
        for table in list_tables():
            rows = connection.execute(select(table).order_by(*table.primary_key)).all()
            found[table.name] = hashlib.sha256(repr(rows).encode()).hexdigest()
    for key, _ in store.objects.list_objects():
        found[key] = hashlib.sha256(store.objects.get(key)).hexdigest()
    return {name: value for name, value in found.items() if name not in but}


def filled(store: Store) -> None:
    for n in range(3):
        store.make(b"a recording, %d" % n)
    ledger = JobQueue(store.database)
    for _ in range(2):
        ledger.enqueue(JOB)
    (claim,) = ledger.claim(1)
    ledger.record_progress(claim, 0.5, "half")
    ledger.record_success(claim, lambda session: None)


@pytest.mark.parametrize("target", ["backup", "backup.zip"])
def test_after_the_loss_of_everything_all_hashes_are_as_before(at: Open, tmp_path: Path, target: str) -> None:
    store = at("data")
    filled(store)
    before = hashes(store)
    options = ["--data-dir", str(tmp_path / "data")]
    run = CliRunner().invoke(app, ["backup", str(tmp_path / target), *options])
    assert (run.exit_code, "3 files" in run.output) == (0, True), run.output
    store.database.close()
    shutil.rmtree(tmp_path / "data")
    run = CliRunner().invoke(app, ["restore", str(tmp_path / target), *options])
    assert run.exit_code == 0, run.output
    again = open_store(store.database.url, tmp_path / "data")
    assert hashes(again) == before
    assert list(check_storage(again.database, again.objects)) == []
    second = CliRunner().invoke(app, ["restore", str(tmp_path / target), *options])
    assert (second.exit_code, "empty" in second.output) == (2, True), second.output
    again.database.close()


def test_what_was_being_computed_waits_again_after_a_restore(at: Open, tmp_path: Path) -> None:
    store = at("data")
    ledger = JobQueue(store.database)
    job_id = ledger.enqueue(JOB)
    ledger.claim(1)
    back_up(store.database, store.objects, tmp_path / "backup")
    other = at("other")
    restore(other.database, other.objects, tmp_path / "backup", tmp_path)
    (claim,) = JobQueue(other.database).claim(1)
    assert (claim.job_id, claim.attempt) == (job_id, 2)


def test_a_second_backup_copies_what_is_new(at: Open, tmp_path: Path) -> None:
    store = at("data")
    filled(store)
    back_up(store.database, store.objects, tmp_path / "backup")
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "backup" / "objects").iterdir()}
    store.make(b"one more")
    assert back_up(store.database, store.objects, tmp_path / "backup").objects == 4
    assert all(path.stat().st_mtime_ns == moment for path, moment in written.items())


def test_a_damaged_or_cut_backup_is_refused_and_nothing_is_restored(at: Open, tmp_path: Path) -> None:
    store = at("data")
    filled(store)
    backup = tmp_path / "backup"
    empty = at("empty")
    options = ["restore", str(backup), "--data-dir", str(tmp_path / "empty")]
    for damage in ("objects", "rows", "manifest"):
        back_up(store.database, store.objects, backup)
        if damage == "objects":
            next((backup / "objects").iterdir()).write_bytes(b"else")
        elif damage == "rows":
            (rows,) = backup.glob("tables-*/resources.jsonl")
            rows.write_text("".join(rows.read_text().splitlines(keepends=True)[:-1]))
        else:
            (backup / "manifest.json").unlink()
        run = CliRunner().invoke(app, options)
        assert run.exit_code == 2, run.output
        assert empty.resources.list_page("robot", 5).items == ()
        shutil.rmtree(backup)


def emptied(store: Store) -> None:
    with store.database.engine.begin() as connection:
        for table in reversed(list_tables()):
            connection.execute(table.delete())


@pytest.mark.slow
def test_a_backup_of_sqlite_is_restored_into_postgresql(at: Open, tmp_path: Path, postgresql: str) -> None:
    store = at("data")
    filled(store)
    back_up(store.database, store.objects, tmp_path / "backup")
    other = open_store(postgresql, tmp_path / "other")
    migrate(other.database)
    emptied(other)
    restore(other.database, other.objects, tmp_path / "backup", tmp_path)
    assert hashes(other) == hashes(store)
    JobQueue(other.database).enqueue(JOB)  # its event has a number of its own
    emptied(other)  # others use it, too
    other.database.close()


@pytest.fixture(scope="module")
def model(client: TestClient) -> dict[str, Any]:
    description = {"format": "modified_dh", "content": library_table("scara")}
    robot = client.post("/v1/robots", json={"name": "scara", "description": description}).json()

    def made(path: str, body: dict[str, Any]) -> dict[str, Any]:
        answer = client.post(path, json=body)
        assert answer.status_code == 202, answer.text
        where = answer.headers["location"]
        return dict(wait_for(lambda: _ended(client.get(where).json()), timeout=60))

    virtual = {
        "robot_id": robot["id"],
        "effects": [{"effect": "coulomb"}],
        "trajectory": {"duration": 8.0, "sampling_rate": 100.0},
        "seed": 1,
    }
    recording = made("/v1/simulations", virtual)["result"]["measurement_id"]
    return made("/v1/identifications", {"robot_id": robot["id"], "measurement_ids": [recording]})


def _ended(view: dict[str, Any]) -> dict[str, Any] | None:
    assert view["status"] in ("queued", "running", "succeeded"), view
    return view if view["status"] == "succeeded" else None


def test_a_robot_goes_to_another_service_with_all_that_belongs_to_it(
    client: TestClient, services: Services, model: dict[str, Any], at: Open, tmp_path: Path
) -> None:
    stranger = {"name": "stranger", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    stranger_id = client.post("/v1/robots", json=stranger).json()["id"]
    answer = client.get(f"/v1/robots/{model['robot_id']}/bundle")
    assert (answer.status_code, answer.headers["content-type"]) == (200, "application/zip")
    assert list(services.settings.uploads_dir.iterdir()) == []
    bundle = tmp_path / "bundle.zip"
    bundle.write_bytes(answer.content)
    other = at("other")
    for _ in range(2):  # the second time nothing is there to be done
        run = CliRunner().invoke(app, ["import-robot", str(bundle), "--data-dir", str(tmp_path / "other")])
        assert (run.exit_code, run.output.splitlines()[0]) == (0, model["robot_id"]), run.output
    there = other.resources.get("identification", model["id"])
    assert identifications.show_identification(there).model_dump(mode="json") == model
    recording = other.resources.get("measurement", model["request"]["measurement_ids"][0])
    here = services.resources.get("measurement", recording.id)
    assert measurements.show_measurement(recording) == measurements.show_measurement(here)
    assert list(check_storage(other.database, other.objects)) == []
    assert other.resources.find(stranger_id) is None
    assert JobQueue(other.database).read_events(model["job_id"])[0][-1].data == {"state": "succeeded"}
    assert client.get("/v1/robots/rob_nothing/bundle").status_code == 404


def test_a_bundle_that_was_tampered_with_is_refused(
    services: Services, model: dict[str, Any], at: Open, tmp_path: Path
) -> None:
    from dynident_service.storage.robot_bundle import export_robot

    bundle, changed = tmp_path / "bundle.zip", tmp_path / "changed.zip"
    export_robot(services.database, services.objects, model["robot_id"], bundle)
    other = at("other")
    with zipfile.ZipFile(bundle) as whole:
        content = {name: whole.read(name) for name in whole.namelist()}
    job = json.loads(content["tables/jobs.jsonl"].splitlines()[0])
    tampered = {
        "tables/jobs.jsonl": json.dumps({**job, "state": "queued", "function": "os:abort"}).encode(),
        "tables/objects.jsonl": content["tables/objects.jsonl"].replace(b'"key": "', b'"key": "../'),
        "tables/resources.jsonl": content["tables/resources.jsonl"].replace(b'"kind": "robot"', b'"kind": "report"'),
    }
    for name, put in tampered.items():
        with zipfile.ZipFile(changed, "w") as file:
            for other_name, kept in content.items():
                file.writestr(other_name, put if other_name == name else kept)
        run = CliRunner().invoke(app, ["import-robot", str(changed), "--data-dir", str(tmp_path / "other")])
        assert (run.exit_code, "cannot be used" in run.output) == (2, True), run.output
    assert other.resources.list_page("robot", 5).items == ()


def test_a_backup_of_an_older_version_is_read_and_one_of_a_newer_is_not(at: Open, tmp_path: Path) -> None:
    store, backup = at("data"), tmp_path / "backup"
    filled(store)
    back_up(store.database, store.objects, backup)
    manifest = backup / "manifest.json"
    (tables_there,) = backup.glob("tables-*")
    rows = tables_there.rename(backup / "tables") / "resources.jsonl"  # as the first format had them
    new = ("tags", "archived")
    older = [{k: v for k, v in json.loads(row).items() if k not in new} for row in rows.read_text().splitlines()]
    rows.write_text("\n".join(json.dumps(row) for row in older))
    said = json.loads(manifest.read_text())
    del said["tables"]
    manifest.write_text(json.dumps({**said, "dynident_archive": 1, "revision": "0003"}))
    other = at("other")
    restore(other.database, other.objects, backup, tmp_path)
    assert hashes(other) == hashes(store)
    manifest.write_text(json.dumps({**said, "revision": "9999", "dynident": "99.0"}))
    with pytest.raises(DynidentError, match=r"99\.0, which is newer"):
        restore(other.database, other.objects, backup, tmp_path)
