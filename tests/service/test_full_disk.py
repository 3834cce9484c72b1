"""A disk that is full in earnest, in the middle of a job and of an upload: nothing is lost, and all goes on later."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx2
import pytest
from service_helpers import TWO_JOINTS, serving, wait_for
from support.measurement_uploads import as_csv, files_in, sound

from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.integrity_check import check_storage
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import FINAL, NewJob, NewResource
from dynident_service.storage.resource_repository import Resources

pytestmark = pytest.mark.slow
MEGABYTE = 1_000_000


class SmallDisk:
    """A file system of its own in memory, which somebody else may fill."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._filler = folder / "filler"

    def fill(self) -> None:
        """Take all the room that is left."""
        with suppress(OSError), self._filler.open("ab", buffering=0) as filler:
            while True:
                filler.write(b"\0" * 4096)

    def make_room(self) -> None:
        """Give it back."""
        self._filler.unlink()


@pytest.fixture
def disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[SmallDisk]:
    folder = tmp_path / "disk"
    folder.mkdir()
    if shutil.which("mount") is None or os.geteuid() != 0:
        pytest.skip("only root may mount a small disk: what a full one does was NOT tried")
    command = ["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", folder]
    if subprocess.run(command, capture_output=True, check=False).returncode != 0:
        pytest.skip("no small disk can be mounted here: what a full one does was NOT tried")
    (folder / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder / "tmp"))
    yield SmallDisk(folder)
    subprocess.run(["umount", "-l", folder], check=True)


@pytest.fixture
def settings(disk: SmallDisk) -> Settings:
    return Settings(data_dir=disk.folder / "data", port=0, workers=1, reserved_bytes=0)


@pytest.fixture
def http(settings: Settings) -> Iterator[httpx2.Client]:
    with serving(settings) as address, httpx2.Client(base_url=address, timeout=60.0) as client:
        yield client


@pytest.fixture
def database(http: httpx2.Client, settings: Settings) -> Iterator[Database]:
    opened = Database(settings.database)
    yield opened
    opened.close()


@pytest.fixture
def objects(settings: Settings) -> ObjectStore:
    return ObjectStore(settings.objects, settings.cache_dir)


def test_a_job_whose_result_finds_no_room_waits_for_it_and_ends_once_and_well(
    disk: SmallDisk, http: httpx2.Client, database: Database, objects: ObjectStore, tmp_path: Path
) -> None:
    note, go = tmp_path / "note", tmp_path / "go"
    asked = {"note": str(note), "go": str(go), "size": 2 * MEGABYTE}
    resources, ledger = Resources(database, objects), JobQueue(database)
    made = resources.create(NewResource("report", {}, job=NewJob("report", "small_jobs:keeps", asked)))
    assert made.job is not None
    wait_for(note.exists)
    disk.fill()
    go.touch()
    refused = http.post("/v1/robots", json={"name": "arm", "description": described()})
    assert refused.status_code == 507
    assert refused.json()["title"] == "Disk full"
    assert http.get("/healthz").status_code == 200
    time.sleep(8.0)  # longer than its lease is renewed
    assert ledger.get(made.job.id).state == "running"
    disk.make_room()
    ended = wait_for(lambda: next((job for job in (ledger.get(made.job.id),) if job.state in FINAL), None), 60.0)
    assert (ended.state, ended.attempt) == ("succeeded", 1)
    assert sum(event.data.get("state") in FINAL for event in ledger.read_events(ended.id)[0]) == 1
    (owned,) = resources.get("report", made.id).objects.values()
    assert len(objects.get(owned.key)) == owned.size == 2 * MEGABYTE
    assert list(check_storage(database, objects)) == []


def test_an_upload_during_which_the_disk_fills_up_leaves_nothing_and_may_be_sent_again(
    disk: SmallDisk, http: httpx2.Client, settings: Settings, database: Database, objects: ObjectStore
) -> None:
    robot = http.post("/v1/robots", json={"name": "arm", "description": described()}).json()
    content = as_csv(sound(60_000))
    assert len(content) > 6 * MEGABYTE
    body = form({"robot_id": robot["id"], "name": "run", "role": "identification"}, content)
    kinds = {"content-type": "multipart/form-data; boundary=edge", "idempotency-key": "once"}
    before = files_in(settings.data_dir / "objects")

    def parts() -> Iterator[bytes]:
        yield body[: len(body) // 2]
        time.sleep(1.0)
        disk.fill()
        yield body[len(body) // 2 :]

    headers = {**kinds, "content-length": str(len(body))}
    refused = http.post("/v1/measurements", content=parts(), headers=headers)
    assert refused.status_code == 507
    assert Resources(database, objects).list_page("measurement", 10).items == ()
    assert files_in(settings.data_dir / "objects") == before
    assert files_in(settings.uploads_dir) == set()
    disk.make_room()
    sent = http.post("/v1/measurements", content=body, headers=kinds)
    assert sent.status_code == 201, sent.text
    assert http.get(f"/v1/measurements/{sent.json()['id']}/content").content == content
    assert list(check_storage(database, objects)) == []


def described() -> dict[str, object]:
    return {"format": "modified_dh", "content": TWO_JOINTS}


def form(metadata: dict[str, str], content: bytes) -> bytes:
    """A form with a file, as it is sent."""
    said = f'--edge\r\nContent-Disposition: form-data; name="metadata"\r\n\r\n{json.dumps(metadata)}\r\n'
    file = '--edge\r\nContent-Disposition: form-data; name="file"; filename="run.csv"\r\n\r\n'
    return said.encode() + file.encode() + content + b"\r\n--edge--\r\n"
