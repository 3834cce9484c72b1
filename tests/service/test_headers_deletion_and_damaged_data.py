"""What every answer carries, what is forgotten, and what is said when the disk is full or what is stored is damaged."""

from __future__ import annotations

import errno
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of, wait_for
from sqlalchemy import update
from sqlalchemy.exc import OperationalError
from support.measurement_uploads import as_csv, files_in, sound, upload

from dynident_service.settings import Settings
from dynident_service.shared.upload_forms import _SentFile
from dynident_service.storage.database_tables import JobRow, RetryRow
from dynident_service.storage.deletion_and_expiry import delete_expired
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import Dependency, NewJob, NewResource
from dynident_service.storage.resource_repository import Resources
from dynident_service.storage_and_engine import Services


@contextmanager
def started(folder: Path) -> Iterator[TestClient]:
    app = app_of(Settings(data_dir=folder / "data", workers=1))

    @app.get("/broken")
    def broken() -> None:
        raise RuntimeError("secret of the machine room")

    with TestClient(app, "http://127.0.0.1", raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def own(tmp_path: Path) -> Iterator[TestClient]:
    """A service of a test's own, which it may damage."""
    with started(tmp_path) as client:
        yield client


@pytest.fixture(scope="module")
def unharmed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A service with a route that breaks, which is only asked."""
    with started(tmp_path_factory.mktemp("unharmed")) as client:
        yield client


@pytest.fixture
def own_services(own: TestClient) -> Services:
    found = own.app.state.services  # type: ignore[attr-defined]
    assert isinstance(found, Services)
    return found


@pytest.fixture
def own_robot(own: TestClient) -> dict[str, Any]:
    body = {"name": "two joints", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    return dict(own.post("/v1/robots", json=body).json())


PATHS = [
    "/",
    "/docs",
    "/openapi.json",
    "/healthz",
    "/readyz",
    "/metrics",
    "/v1/robots",
    "/v1/robots/x",
    "/no",
    "/broken",
]


@pytest.mark.sweep
@pytest.mark.parametrize("path", [*PATHS, "/", "/workbench/style.css", "/workbench/nothing.js"])
def test_every_answer_is_taken_for_what_it_says_and_runs_nothing_from_elsewhere(
    unharmed: TestClient, path: str
) -> None:
    answer = unharmed.get(path)
    assert answer.headers["x-content-type-options"] == "nosniff"
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy or "default-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy


def test_the_documentation_needs_nothing_from_elsewhere_and_no_scripts(client: TestClient) -> None:
    page = client.get("/docs").text
    assert "<script" not in page
    assert re.findall(r"(?:src|href)=['\"](?!#|/openapi\.json)", page) == []
    for path in client.get("/openapi.json").json()["paths"]:
        assert path in page
    assert "id='RobotRequest'" in page
    assert client.get("/redoc").status_code == 404


def test_a_refused_deletion_lists_some_of_many_and_says_how_many(own: TestClient, own_services: Services) -> None:
    services = own_services
    robot = services.resources.create(NewResource("robot", {}))
    need = Dependency(robot.id, "robot", "robot", "/robot_id")
    made = [services.resources.create(NewResource("measurement", {}, rests_on=(need,))) for _ in range(50)]
    answer = own.delete(f"/v1/robots/{robot.id}")
    assert answer.status_code == 409
    assert answer.json()["dependents_count"] == 50
    listed = [one["id"] for one in answer.json()["dependents"]]
    assert listed == sorted(one.id for one in made)[:20]
    assert "40 more" in answer.json()["detail"]


def test_events_of_jobs_that_ended_long_ago_and_old_retry_keys_are_forgotten(
    own: TestClient, own_services: Services
) -> None:
    database, ledger = own_services.database, own_services.job_queue
    body = {"name": "two joints", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    retried = own.post("/v1/robots", json=body, headers={"Idempotency-Key": "k"}).json()["id"]
    old, young = (ledger.enqueue(NewJob("report", "small_jobs:answer")) for _ in range(2))
    own_services.engine.wake()
    for job_id in (old, young):
        wait_for(lambda job_id=job_id: ledger.get(job_id).finished_at)
    assert delete_expired(database, timedelta(days=30)) == 0
    with database.write() as session:
        finished_at = ledger.get(old).finished_at
        assert finished_at is not None
        session.execute(update(JobRow).where(JobRow.id == old).values(finished_at=finished_at - timedelta(days=31)))
        session.execute(update(RetryRow).values(created_at=finished_at - timedelta(days=31)))
    assert delete_expired(database, timedelta(days=30)) == 1
    events, ended = ledger.read_events(old)
    assert [event.data for event in events] == [{"state": "succeeded"}]
    assert ended
    assert len(ledger.read_events(young)[0]) == 4
    assert own.post("/v1/robots", json=body, headers={"Idempotency-Key": "k"}).json()["id"] != retried


FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("where", "name", "error"),
    [
        (Resources, "create", OperationalError("INSERT", {}, Exception("database or disk is full"))),
        (ObjectStore, "put_hashed", OSError("Generic LocalFileSystem error: No space left on device (os error 28)")),
        (_SentFile, "write", FULL),
    ],
    ids=["database", "objects", "upload"],
)
def test_a_full_disk_is_told_as_that_and_leaves_no_half_files(
    own: TestClient,
    own_services: Services,
    own_robot: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
    where: Any,
    name: str,
    error: Exception,
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise error

    if isinstance(where, str):
        monkeypatch.setattr(f"{where}.{name}", full)
    else:
        monkeypatch.setattr(where, name, full)
    answer = upload(own, own_robot, as_csv(sound(300)))
    assert answer.status_code == 507, answer.text
    assert "disk" in answer.json()["detail"]
    assert files_in(own_services.settings.uploads_dir) == set()
    assert own_services.resources.list_page("measurement", 10).items == ()


def test_an_upload_leaves_room_for_the_database(
    own: TestClient, own_services: Services, own_robot: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(own_services.settings.data_dir)
    left = own_services.settings.reserved_bytes + 1000
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=left))
    answer = upload(own, own_robot, as_csv(sound(300)))
    assert answer.status_code == 507
    assert "DYNIDENT_RESERVED_BYTES" in answer.json()["detail"]


def test_room_on_the_disk_is_asked_for_before_anything_is_received(
    own: TestClient, own_services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage(own_services.settings.data_dir)
    left = own_services.settings.reserved_bytes + 1_000_000
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=left))
    for path, method in (("/v1/measurements", "POST"), ("/v1/imports", "POST"), ("/v1/robots/rob_a/meshes", "PUT")):

        def content() -> Iterator[bytes]:
            raise AssertionError("it was received")
            yield b""

        headers = {"content-type": "multipart/form-data; boundary=b", "content-length": "2000000"}
        assert own.request(method, path, content=content(), headers=headers).status_code == 507


def test_a_file_is_received_in_the_data_directory_and_not_in_the_folder_of_the_system(
    own: TestClient, own_robot: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "not there"))
    content = as_csv(sound(20_000))
    assert len(content) > 1_500_000  # more than is ever held in memory
    assert upload(own, own_robot, content).status_code == 201


def test_a_database_that_is_away_is_told_as_that(own: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    def away(*_: Any, **__: Any) -> None:
        raise OperationalError("SELECT", {}, Exception("server closed the connection"))

    monkeypatch.setattr(Resources, "list_page", away)
    answer = own.get("/v1/robots")
    assert answer.status_code == 503
    assert answer.headers["retry-after"] == "5"
    assert "SELECT" not in answer.text


def test_a_job_that_finds_the_disk_full_says_so(
    own_services: Services,
) -> None:
    job_id = own_services.job_queue.enqueue(NewJob("report", "small_jobs:fills_the_disk"))
    own_services.engine.wake()
    job = wait_for(lambda: own_services.job_queue.get(job_id).finished_at and own_services.job_queue.get(job_id))
    assert job.state == "failed"
    assert job.error["status"] == 507


@pytest.mark.parametrize("damage", ["missing", "cut"])
def test_a_file_that_is_missing_or_cut_makes_the_service_not_ready_until_it_is_mended(
    own: TestClient, own_services: Services, own_robot: dict[str, Any], damage: str
) -> None:
    content = as_csv(sound(300))
    made = upload(own, own_robot, content).json()
    wait_for(lambda: own.get("/readyz").status_code == 200)
    (file,) = (own_services.settings.data_dir / "objects").rglob(made["sha256"])
    file.unlink() if damage == "missing" else file.write_bytes(content[:100])
    own_services.housekeeping.check_stored_data()
    ready = own.get("/readyz")
    assert ready.status_code == 503
    assert f"{damage}: 1" in ready.json()["checks"]["stored"]
    assert own.get(f"/v1/measurements/{made['id']}/content").status_code == 500
    upload(own, own_robot, content)
    own_services.housekeeping.check_stored_data()
    assert own.get("/readyz").status_code == 200
    assert own.get(f"/v1/measurements/{made['id']}/content").content == content


def test_damaged_pages_of_the_database_make_the_service_not_ready(own: TestClient, own_services: Services) -> None:
    for _ in range(300):
        own_services.resources.create(NewResource("robot", {"filling": "x" * 500}))
    own_services.database.close()
    file = own_services.settings.data_dir / "dynident.sqlite3"
    for suffix in ("-wal", "-shm"):
        file.with_name(file.name + suffix).unlink(missing_ok=True)
    content = bytearray(file.read_bytes())
    content[4096 * 5 : -4096] = b"\x5a" * (len(content) - 4096 * 6)
    file.write_bytes(content)
    own_services.housekeeping.check_stored_data()
    ready = own.get("/readyz")
    assert ready.status_code == 503
    assert "database" in ready.json()["checks"]["stored"]


def test_an_engine_that_lost_its_cluster_makes_the_service_not_ready(own: TestClient, own_services: Services) -> None:
    wait_for(lambda: own_services.engine.state == "ready")
    own_services.engine.close()
    assert own.get("/readyz").status_code == 503


def test_a_service_starts_without_loading_the_science():
    heavy = ("casadi", "pinocchio", "ruckig")
    program = f"import sys, dynident_service.app; print([one for one in {heavy} if one in sys.modules])"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert told.strip() == "[]"
