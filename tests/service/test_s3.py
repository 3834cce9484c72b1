"""The object store and the service on a store that speaks S3."""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from s3_server import BUCKET, S3, s3_server
from service_helpers import TWO_JOINTS, wait_for
from support.measurement_uploads import as_csv, sound, upload

from dynident_service.app import create_app
from dynident_service.problems import ProblemError
from dynident_service.settings import Settings
from dynident_service.storage.database import Database, migrate
from dynident_service.storage.deletion_and_expiry import sweep_objects
from dynident_service.storage.integrity_check import check_storage
from dynident_service.storage.object_store import CHUNK, ObjectGone, ObjectStore
from dynident_service.storage.repository_values import NewResource, OwnedObject
from dynident_service.storage.resource_repository import Resources

CONTENT = b"t,q1,tau1\n" * 100
AT_ONCE = timedelta(0)
LARGE = 160_000_000
STORES_AND_READS = """
import resource, sys, tempfile
from pathlib import Path
from dynident_service.storage.object_store import ObjectStore
store = ObjectStore(sys.argv[1], Path(sys.argv[2]))
store.ping()
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
with open(sys.argv[3], "rb") as file:
    key = store.put_file(file).key
read = sum(len(part) for part in store.stream(key))
print(read, store.fetch_file(key).stat().st_size, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("s3") / "log"


@pytest.fixture(scope="module")
def s3(log: Path) -> Iterator[S3]:
    with s3_server(log) as server, pytest.MonkeyPatch.context() as patch:
        for name, value in server.environment.items():
            patch.setenv(name, value)
        yield server


@pytest.fixture
def objects(s3: S3, tmp_path: Path) -> Iterator[ObjectStore]:
    """A store whose bucket is empty at the end."""
    store = ObjectStore(BUCKET, tmp_path / "cache")
    yield store
    for key, _ in list(store.list_objects()):
        store.delete(key)


@pytest.fixture
def resources(objects: ObjectStore, tmp_path: Path) -> Iterator[tuple[Database, Resources]]:
    database = Database(f"sqlite:///{tmp_path / 'db.sqlite3'}")
    migrate(database)
    yield database, Resources(database, objects)
    database.close()


def new(resources: Resources) -> NewResource:
    stored = resources.put(CONTENT)
    return NewResource("robot", {}, objects=(OwnedObject("original", stored.key, stored.size, "text/csv"),))


def place(key: str) -> str:
    return f"{key[:2]}/{key}"


def test_an_object_comes_back_under_its_hash_is_stored_once_and_deleted_twice(objects: ObjectStore) -> None:
    objects.ping()
    content = os.urandom(CHUNK // 2)
    stored = objects.put_bytes(content)
    assert (stored.key, stored.size, stored.created) == (hashlib.sha256(content).hexdigest(), len(content), True)
    assert not objects.put_bytes(content).created
    assert objects.get(stored.key) == content == b"".join(objects.stream(stored.key))
    assert objects.fetch_file(stored.key).read_bytes() == content
    assert (stored.key, len(content)) in list(objects.list_objects())
    objects.delete(stored.key)
    objects.delete(stored.key)
    assert objects.get_size(stored.key) is None


def test_a_large_file_goes_in_parts_and_is_never_whole_in_memory(
    s3: S3, objects: ObjectStore, tmp_path: Path, log: Path
) -> None:
    file = tmp_path / "large"
    block = os.urandom(1_000_000)
    with file.open("wb") as written:
        for number in range(LARGE // len(block)):
            written.write(number.to_bytes(8, "little") + block[8:])
    command = [sys.executable, "-c", STORES_AND_READS, BUCKET, str(tmp_path / "copies"), str(file)]
    told = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    read, copied, grown = (int(one) for one in told.split())
    assert (read, copied) == (LARGE, LARGE)
    unit = 1 if sys.platform == "darwin" else 1024
    assert grown * unit < LARGE / 2
    assert sum("partNumber=" in one for one in s3.requests(log)) >= LARGE // CHUNK


def test_a_missing_object_is_said_to_be_missing(objects: ObjectStore) -> None:
    key = hashlib.sha256(b"nothing").hexdigest()
    for read in (objects.get, objects.fetch_file, lambda one: list(objects.stream(one))):
        with pytest.raises(ProblemError, match="missing"):
            read(key)
    assert objects.is_damaged(key)


def test_a_cut_object_is_noticed_however_it_is_read_and_mended_by_the_next_upload(s3: S3, objects: ObjectStore) -> None:
    key = objects.put_bytes(CONTENT).key
    s3.write(place(key), CONTENT[:-1])
    received: list[bytes] = []
    with pytest.raises(ProblemError, match="is damaged"):
        received.extend(objects.stream(key))
    assert b"".join(received) != CONTENT[:-1]  # nobody takes it for whole
    for read in (objects.get, objects.fetch_file):
        with pytest.raises(ProblemError, match="is damaged"):
            read(key)
    assert objects.put_bytes(CONTENT).created
    assert objects.get(key) == CONTENT


@pytest.mark.parametrize("size", [0, len(CONTENT), CHUNK, CHUNK + 1, 2 * CHUNK])
def test_a_changed_object_of_the_same_size_is_mended_by_the_next_upload_and_a_sound_one_is_not_sent_again(
    s3: S3, objects: ObjectStore, log: Path, size: int
) -> None:
    content = os.urandom(size)
    key = objects.put_bytes(content).key
    before = len(s3.requests(log))
    assert not objects.put_bytes(content).created
    asked = [one for one in s3.requests(log)[before:] if place(key) in one]
    assert asked
    assert all('"HEAD ' in one for one in asked)
    if size:
        s3.write(place(key), bytes(content[:-1] + bytes([content[-1] ^ 1])))
        assert objects.is_damaged(key)
        assert objects.put_bytes(content).created
        assert not objects.is_damaged(key)


def test_the_doctor_names_what_is_missing_cut_or_changed_and_whose_it_is(
    s3: S3, objects: ObjectStore, resources: tuple[Database, Resources]
) -> None:
    database, repository = resources
    made = repository.create(new(repository))
    key = made.objects["original"].key
    assert list(check_storage(database, objects)) == []
    for damage, trouble in ((CONTENT[:-1], "cut"), (CONTENT[:-1] + b"?", "damaged"), (None, "missing")):
        s3.write(place(key), damage)
        (finding,) = check_storage(database, objects)
        assert (finding.trouble, finding.what, finding.owners) == (trouble, key, (made.id,))


def test_what_nobody_owns_is_swept_and_what_somebody_owns_is_not(
    objects: ObjectStore, resources: tuple[Database, Resources]
) -> None:
    database, repository = resources
    made, second = repository.create(new(repository)), repository.create(new(repository))
    key = made.objects["original"].key
    repository.delete("robot", made.id)
    assert sweep_objects(database, objects, AT_ONCE) == 0
    repository.delete("robot", second.id)
    assert sweep_objects(database, objects, timedelta(minutes=1)) == 0
    assert objects.get_size(key) is not None
    assert sweep_objects(database, objects, AT_ONCE) == 1
    assert objects.get_size(key) is None
    left = new(repository)
    sweep_objects(database, objects, AT_ONCE)
    with pytest.raises(ObjectGone):
        repository.create(left)


def test_the_same_bytes_made_and_deleted_at_the_same_time_are_never_lost(
    objects: ObjectStore, resources: tuple[Database, Resources]
) -> None:
    database, repository = resources
    lost: list[str] = []

    def work() -> None:
        for _ in range(15):
            while True:
                try:
                    made = repository.create(new(repository))
                    break
                except ObjectGone:
                    continue
            if objects.get_size(made.objects["original"].key) is None:
                lost.append(made.id)
            repository.delete("robot", made.id)

    workers = [threading.Thread(target=work) for _ in range(3)]
    for one in workers:
        one.start()
    while any(one.is_alive() for one in workers):
        sweep_objects(database, objects, AT_ONCE)
    assert lost == []


def test_a_service_on_s3_identifies_from_an_uploaded_recording(s3: S3, tmp_path: Path, objects: ObjectStore) -> None:
    settings = Settings(data_dir=tmp_path, workers=1, object_store_url=BUCKET)
    with TestClient(create_app(settings), "http://127.0.0.1") as client:
        assert client.get("/readyz").json()["checks"]["objects"] == "ok"
        described = {"name": "arm", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
        robot = client.post("/v1/robots", json=described).json()
        recording = upload(client, robot, as_csv(sound(400)))
        assert recording.status_code == 201, recording.text
        asked = {"robot_id": robot["id"], "measurement_ids": [recording.json()["id"]]}
        made = client.post("/v1/identifications", json=asked).json()

        def ended() -> bool:
            return str(client.get(f"/v1/jobs/{made['job_id']}").json()["state"]) in ("succeeded", "failed")

        wait_for(ended, 120.0)
        assert client.get(f"/v1/identifications/{made['id']}").json()["status"] == "succeeded"
    assert len(list(objects.list_objects())) > 1
    assert not (tmp_path / "objects").exists()
