"""Quotas: what one key may have stored and under way, and what it is told when it asks for more."""

from __future__ import annotations

import threading
import uuid
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import anyio
import pytest
from alembic import command
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of, wait_for
from sqlalchemy import event, text
from support.arm_with_meshes import ARM, rod
from support.measurement_uploads import as_csv, files_in, sound, upload
from support.stores import Store

from dynident.robot import library_table
from dynident_service import new_key
from dynident_service.api_keys import KeyRing, Scope, create_key, list_keys
from dynident_service.settings import Settings
from dynident_service.storage.backup_and_restore import back_up, restore
from dynident_service.storage.database import WRITES, Database, build_alembic_config, migrate
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.quotas import (
    Account,
    QuotaExceeded,
    QuotaLimits,
    Usage,
    compute_all_usage,
    compute_usage,
    set_account,
)
from dynident_service.storage.repository_values import NewJob, NewResource
from dynident_service.storage.resource_repository import Resources
from dynident_service.storage.robot_bundle import export_robot, import_robot
from dynident_service.storage_and_engine import Services

FORM = "multipart/form-data; boundary=b"
RECORDING = as_csv(sound(400))
DESIGN = {"kind": "random", "trajectory": {"duration": 8.0, "sampling_rate": 100.0}}
Call = Callable[..., TestClient]


@pytest.fixture(scope="module")
def app(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A service that asks for keys; each may have two jobs under way, unless it has limits of its own."""
    settings = Settings(data_dir=tmp_path_factory.mktemp("quotas"), require_keys=True, api_keys=["all"], workers=1)
    settings.quota_jobs = 2
    with TestClient(app_of(settings), "http://127.0.0.1", raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def services(app: TestClient) -> Services:
    found = app.app.state.services  # type: ignore[attr-defined]
    assert isinstance(found, Services)
    return found


@pytest.fixture
def key(app: TestClient, services: Services) -> Call:
    """Makes a key with limits of its own; gives a client that sends it, and has its name as user agent."""

    def made(scope: Scope = "admin", **limits: int) -> TestClient:
        name = f"cell {uuid.uuid4().hex[:8]}"
        sent = create_key(services.database, name, scope, limits=QuotaLimits(**limits))
        client = TestClient(app.app, "http://127.0.0.1", headers={"x-api-key": sent, "user-agent": name})
        client.portal = app.portal  # the service runs already
        return client

    return made


@pytest.fixture
def busy(services: Services, tmp_path: Path) -> Iterator[None]:
    """The one slot is taken by a job of nobody: all others stay queued."""
    note, go = tmp_path / "note", tmp_path / "go"
    services.job_queue.enqueue(NewJob("report", "small_jobs:waits", {"note": str(note), "go": str(go)}))
    services.engine.wake()
    wait_for(note.exists, 60.0)
    yield
    for one in services.job_queue.list_page(100, state="queued")[0]:
        services.job_queue.cancel(one.id)
    go.touch()


def arm(client: TestClient, table: object = TWO_JOINTS) -> dict[str, Any]:
    body = {"name": "arm", "description": {"format": "modified_dh", "content": table}}
    return dict(client.post("/v1/robots", json=body).json())


def usage(client: TestClient) -> dict[str, Any]:
    """What is told of the key that asks."""
    items = client.get("/v1/usage").json()["items"]
    (found,) = (one for one in items if one["key"] == client.headers["user-agent"])
    return dict(found)


def test_jobs_beyond_the_limit_are_refused_with_what_would_help_and_taken_once_one_has_ended(
    key: Call, busy: None
) -> None:
    mine, other = key(), key()
    asked = {"robot_id": arm(mine)["id"], **DESIGN}
    first, second = (mine.post("/v1/designs", json=asked).json() for _ in range(2))
    refused = mine.post("/v1/designs", json=asked)
    assert (refused.status_code, refused.headers["retry-after"]) == (429, "5")
    assert refused.json()["type"] == "urn:dynident:problem:quota-of-jobs-used-up"
    for told in ("2 jobs", "its limit is 2", "DYNIDENT_QUOTA_JOBS", "wait until some have ended, or cancel some"):
        assert told in refused.json()["detail"]
    assert usage(mine)["jobs"] == {"used": 2, "allowed": 2}
    assert len(mine.get(f"/v1/designs?robot_id={asked['robot_id']}").json()["items"]) == 2
    assert other.post("/v1/designs", json=asked).status_code == 202
    assert mine.post(f"/v1/jobs/{first['job_id']}/cancel").status_code == 200
    assert mine.post("/v1/designs", json=asked).status_code == 202
    assert second["status"] == "queued"


def test_a_key_whose_own_limit_is_zero_is_not_limited(key: Call, busy: None) -> None:
    free = key(jobs=0)
    asked = {"robot_id": arm(free)["id"], **DESIGN}
    assert [free.post("/v1/designs", json=asked).status_code for _ in range(3)] == [202] * 3
    assert usage(free)["jobs"] == {"used": 3, "allowed": None}


def test_a_batch_beyond_the_limit_is_refused_as_a_whole(key: Call, busy: None) -> None:
    mine = key()
    robot = arm(mine)
    item = {"robot_id": robot["id"], "measurement_ids": [upload(mine, robot, RECORDING).json()["id"]]}
    refused = mine.post("/v1/identifications/batch", json={"items": [item] * 3})
    assert (refused.status_code, "send fewer at a time" in refused.json()["detail"]) == (429, True)
    assert (usage(mine)["jobs"]["used"], mine.get("/v1/identifications").json()["items"]) == (0, [])
    assert mine.post("/v1/identifications/batch", json={"items": [item] * 2}).status_code == 202


def answered(client: TestClient, headers: dict[str, str], parts: Iterator[bytes]) -> tuple[int, bytes]:
    """How an upload is answered that is sent part by part."""
    came: list[Any] = []

    async def receive() -> dict[str, Any]:
        return {"type": "http.request", "body": next(parts), "more_body": True}

    async def send(message: Any) -> None:
        came.append(message)

    told = {"host": "127.0.0.1", "content-type": FORM, "x-api-key": client.headers["x-api-key"], **headers}
    scope = {"type": "http", "method": "POST", "path": "/v1/measurements", "query_string": b"", "root_path": ""}
    scope |= {"headers": [(name.encode(), value.encode()) for name, value in told.items()], "scheme": "http"}
    assert client.portal is not None
    client.portal.call(client.app, scope, receive, send)
    return came[0]["status"], b"".join(one.get("body", b"") for one in came)


def test_an_upload_for_which_there_is_no_room_is_refused_by_its_length_before_any_of_it_is_received(key: Call) -> None:
    status, told = answered(key(bytes=1_000_000), {"content-length": "500000000"}, iter(()))
    assert status == 507
    for words in (b"quota-of-storage-used-up", b"0 bytes", b"1000000", b"DYNIDENT_QUOTA_BYTES", b"Delete measurements"):
        assert words in told


def test_an_upload_that_does_not_say_its_length_is_refused_as_it_comes_in(key: Call, services: Services) -> None:
    sent = 0

    def parts() -> Iterator[bytes]:
        nonlocal sent
        head = b'--b\r\ncontent-disposition: form-data; name="file"; filename="f"\r\n\r\n'
        while sent < 30_000_000:
            sent += 100_000
            yield head + b"x" * 100_000
            head = b""

    status, told = answered(key(bytes=1_000_000), {"transfer-encoding": "chunked"}, parts())
    assert (status, b"quota-of-storage-used-up" in told) == (507, True)
    assert sent < 2_000_000
    assert files_in(services.settings.uploads_dir) == set()


@pytest.mark.parametrize("announced", [True, False])
def test_uploads_on_their_way_count_so_that_many_at_once_take_no_more_than_is_left(
    key: Call, app: TestClient, services: Services, announced: bool
) -> None:
    client, size, most = key(bytes=1_000_000), 450_000, 4
    assert app.portal is not None
    statuses: list[int] = []

    async def send_together() -> None:
        come_on = anyio.Event()
        came = dict.fromkeys(range(most), 0.0)
        """Bytes of each; none runs ahead of the others, whatever the machine does."""

        async def send_one(number: int) -> None:
            sent = 0

            async def receive() -> dict[str, Any]:
                nonlocal sent
                while sent > min(came.values()):
                    await anyio.sleep(0.002)
                head = b'--b\r\ncontent-disposition: form-data; name="file"; filename="f"\r\n\r\n' if not sent else b""
                if sent >= size - 50_000:
                    await come_on.wait()
                sent += 50_000
                came[number] = sent
                return {"type": "http.request", "body": head + b"x" * 50_000, "more_body": sent < size}

            async def send(message: Any) -> None:
                if message["type"] == "http.response.start":
                    statuses.append(message["status"])
                    came[number] = float("inf")

            length = {"content-length": str(size + 100)} if announced else {"transfer-encoding": "chunked"}
            told = {"host": "127.0.0.1", "content-type": FORM, "x-api-key": client.headers["x-api-key"], **length}
            headers = [(name.encode(), value.encode()) for name, value in told.items()]
            scope = {"type": "http", "method": "POST", "path": "/v1/measurements", "query_string": b"", "root_path": ""}
            await client.app({**scope, "headers": headers, "scheme": "http"}, receive, send)

        async with anyio.create_task_group() as group:
            for number in range(most):
                group.start_soon(send_one, number)
            with anyio.fail_after(60):
                while len(statuses) < most - 2:
                    await anyio.sleep(0.01)
            assert statuses == [507] * (most - 2)  # before any came to its end
            come_on.set()

    app.portal.call(send_together)
    assert sorted(statuses) == [422, 422, 507, 507]  # those that were taken are no forms that end
    assert files_in(services.settings.uploads_dir) == set()


def test_of_a_recording_that_turns_out_too_large_nothing_is_stored(key: Call, services: Services) -> None:
    mine = key(bytes=len(RECORDING) + 100)  # what is made of it to be read faster has no room any more
    robot, folder = arm(mine), services.settings.data_dir
    before = files_in(folder / "objects")
    content = as_csv(sound(401))[: len(RECORDING)].rsplit(b"\n", 1)[0] + b"\n"
    refused = upload(mine, robot, content)
    assert (refused.status_code, "would add" in refused.json()["detail"]) == (507, True), refused.text
    assert files_in(folder / "objects") | files_in(folder / "uploads") == before
    assert usage(mine)["bytes"]["used"] == usage(mine)["recordings"]["used"] == 0


def test_deleting_a_recording_makes_room_at_once_and_a_retry_gets_its_first_answer(key: Call) -> None:
    mine = key(recordings=1, bytes=10_000_000)
    robot = arm(mine)
    made = upload(mine, robot, RECORDING, "once")
    assert usage(mine)["recordings"] == {"used": 1, "allowed": 1}
    refused = upload(mine, robot, as_csv(sound(420)))
    assert (refused.status_code, "stores 1 recordings; its limit is 1" in refused.json()["detail"]) == (507, True)
    assert upload(mine, robot, RECORDING, "once").json() == made.json()
    revised = mine.post(f"/v1/measurements/{made.json()['id']}/revisions", json={"name": "again"})
    assert revised.status_code == 507
    assert mine.delete(made.headers["location"]).status_code == 204
    assert (usage(mine)["recordings"]["used"], usage(mine)["bytes"]["used"]) == (0, 0)
    assert upload(mine, robot, as_csv(sound(420))).status_code == 201


def test_a_file_counts_once_however_often_it_is_used(key: Call, services: Services) -> None:
    mine = key(bytes=10_000_000)
    robot = arm(mine)
    said = {"metadata": f'{{"robot_id": "{robot["id"]}"}}'}
    found = mine.post("/v1/imports", files={"file": ("run.csv", RECORDING)}, data=said).json()
    assert usage(mine)["bytes"]["used"] == len(RECORDING)
    used = mine.post("/v1/measurements", json={"import_id": found["id"], "metadata": found["proposed"]})
    assert used.status_code == 201, used.text
    objects = services.resources.get("measurement", used.json()["id"]).objects
    assert usage(mine)["bytes"]["used"] == len(RECORDING) + objects["recording"].size


def test_a_simulated_recording_belongs_to_who_asked_for_it_and_is_refused_where_there_is_no_room(key: Call) -> None:
    mine = key(recordings=1, bytes=10_000_000)
    asked = {"robot_id": arm(mine, library_table("scara"))["id"], "trajectory": DESIGN["trajectory"]}
    made = mine.post("/v1/simulations", json=asked)
    assert usage(mine)["recordings"]["used"] == 1  # its place is kept
    assert mine.post("/v1/simulations", json=asked).status_code == 507
    wait_for(lambda: usage(mine)["jobs"]["used"] == 0, 60.0)
    found = mine.get(made.headers["location"]).json()
    assert found["status"] == "succeeded", found
    assert (usage(mine)["recordings"]["used"], usage(mine)["jobs"]["used"]) == (1, 0)
    assert usage(mine)["bytes"]["used"] > 0
    assert mine.post("/v1/simulations", json=asked).status_code == 507


def test_meshes_count_for_the_owner_of_the_robot(key: Call) -> None:
    mine, other = key(bytes=5_000), key()
    body = {"name": "arm", "description": {"format": "urdf", "content": ARM}}
    path = f"/v1/robots/{mine.post('/v1/robots', json=body).json()['id']}/meshes"
    assert mine.put(path, files=[("files", ("one.stl", rod(corners=100)))]).status_code == 507
    assert other.put(path, files=[("files", ("two.stl", rod()))]).status_code == 200
    assert usage(mine)["bytes"]["used"] > len(rod())
    assert usage(other)["bytes"]["used"] == 0


def test_a_key_sees_what_it_uses_and_one_that_allows_everything_sees_all(key: Call) -> None:
    reader, admin = key("read", jobs=7), key()
    (own,) = reader.get("/v1/usage").json()["items"]
    assert own["key"] == reader.headers["user-agent"]
    assert (own["jobs"], own["bytes"]) == ({"used": 0, "allowed": 7}, {"used": 0, "allowed": None})
    seen = {one["key"]: one for one in admin.get("/v1/usage").json()["items"]}
    assert {own["key"], admin.headers["user-agent"], None} <= set(seen)
    assert (seen[own["key"]], seen[None]["jobs"]["allowed"]) == (own, None)


def test_a_request_counts_for_its_key_once_that_was_used_and_for_its_address_before(key: Call, app: TestClient) -> None:
    client = key()

    def party(sent: str) -> str:
        headers = [(b"x-api-key", sent.encode())]
        return str(app.app.state.keys.find_party({"headers": headers, "client": ("192.0.2.1", 1)}))  # type: ignore[attr-defined]

    sent = client.headers["x-api-key"]
    assert party(sent) == "address 192.0.2.1"
    assert client.get("/v1/usage").status_code == 200
    assert party(sent) == f"key {client.headers['user-agent']}"
    assert app.get("/v1/usage", headers={"x-api-key": "guessed"}).status_code == 401
    assert party("guessed") == "address 192.0.2.1"


def test_the_command_to_make_a_key_gives_it_limits_and_lists_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DYNIDENT_DATA_DIR", str(tmp_path))
    monkeypatch.setenv("DYNIDENT_QUOTA_JOBS", "9")
    assert new_key.main(["cell 7", "--quota-jobs", "4", "--quota-bytes", "0"]) == 0
    sent = capsys.readouterr().out.strip()
    assert new_key.main(["--list"]) == 0
    assert "at most 0 bytes, 4 jobs" in capsys.readouterr().out
    assert Settings().quota_jobs == 9
    database = Database(Settings().database)
    holder = KeyRing(Settings(), database).find_holder(sent)
    assert holder is not None
    assert holder.limits == list_keys(database)[0].limits == QuotaLimits(bytes=0, jobs=4)
    database.close()


@pytest.fixture
def empty(new_database: Database, tmp_path: Path) -> Store:
    """A store whose database has no tables yet."""
    objects = ObjectStore((tmp_path / "objects").as_uri(), tmp_path / "cache")
    return Store(new_database, objects, Resources(new_database, objects))


@contextmanager
def acting_for(name: str, **limits: int) -> Iterator[None]:
    set_account(Account(name, QuotaLimits(**limits)))
    try:
        yield
    finally:
        set_account(None)


def job() -> NewResource:
    return NewResource("report", {}, job=NewJob("report", "small_jobs:answer"))


def test_what_was_stored_before_keys_counted_belongs_to_nobody(empty: Store) -> None:
    with empty.database.engine.execution_options(**{WRITES: True}).begin() as connection:
        command.upgrade(build_alembic_config(connection), "0006")
        at = "'2025-01-01 00:00:00'"
        for statement in (
            f"INSERT INTO resources (id, kind, created_at, request) VALUES ('mea_old', 'measurement', {at}, '{{}}')",
            "INSERT INTO objects (resource_id, role, key, size, media_type) VALUES ('mea_old', 'original', 'a', 7, '')",
            "INSERT INTO jobs (id, kind, function, arguments, state, fraction, message, attempt, deaths, "
            "cancel_requested, created_at) "
            f"VALUES ('job_old', 'report', 'a:b', '{{}}', 'queued', 0, '', 0, 0, false, {at})",
            f"INSERT INTO api_keys (sha256, name, created_at) VALUES ('h', 'old', {at})",
        ):
            connection.execute(text(statement))
    migrate(empty.database)
    assert list_keys(empty.database)[0].limits == QuotaLimits()
    assert empty.resources.get("measurement", "mea_old").objects["original"].size == 7
    with acting_for("old", bytes=1, recordings=1, jobs=1):
        empty.resources.create(job())
    with empty.database.read() as session:
        assert compute_all_usage(session) == {None: Usage(7, 1, 1), "old": Usage(jobs=1)}
    with empty.database.engine.execution_options(**{WRITES: True}).begin() as connection:
        command.check(build_alembic_config(connection))


def test_of_many_that_come_at_once_no_more_are_taken_than_there_is_room_for(empty: Store) -> None:
    migrate(empty.database)
    together, refused = threading.Barrier(8), []

    def ask(number: int) -> None:
        files = empty.put(b"recording %d" % number).objects
        measurement = NewResource("measurement", {}, objects=files)
        for new, limits in ((job(), {"jobs": 3}), (measurement, {"recordings": 3}), (measurement, {"bytes": 55})):
            together.wait()
            with acting_for(f"cell of {limits}", **limits):
                try:
                    empty.resources.create(new)
                except QuotaExceeded as error:
                    refused.append(error.problem.status)

    threads = [threading.Thread(target=ask, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    with empty.database.read() as session:
        assert compute_usage(session, "cell of {'jobs': 3}").jobs == 3
        assert compute_usage(session, "cell of {'recordings': 3}").recordings == 3
        assert compute_usage(session, "cell of {'bytes': 55}").bytes == 5 * len(b"recording 0")
    assert sorted(refused) == [429] * 5 + [507] * 8


def test_without_limits_nothing_more_is_asked_of_the_database_and_with_them_only_what_one_key_has(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    database, objects = Database(f"sqlite:///{tmp_path / 'q'}"), ObjectStore(tmp_path.as_uri(), tmp_path / "c")
    migrate(database)
    resources, seen = Resources(database, objects), list[tuple[str, Any]]()
    event.listen(database.engine, "before_cursor_execute", lambda *told: seen.append((told[2], told[3])))

    def statements(name: str | None, **limits: int) -> list[tuple[str, Any]]:
        seen.clear()
        set_account(None if name is None else Account(name, QuotaLimits(**limits)))
        resources.create(NewResource("simulation", {}, job=NewJob("simulation", "a:b")))
        set_account(None)
        return list(seen)

    nobody = statements(None)
    assert len(statements("cell")) == len(statements("cell", bytes=0, jobs=0)) == len(nobody)
    limited = statements("cell", bytes=100, recordings=100, jobs=100)
    assert len(limited) == len(nobody) + 4
    for statement, values in (one for one in limited if one[0].startswith("SELECT")):
        with database.engine.connect() as connection:
            plan = [row[3] for row in connection.exec_driver_sql(f"EXPLAIN QUERY PLAN {statement}", values)]
        assert any("owner" in step for step in plan), (statement, plan)
        assert not any(step.startswith(("SCAN resources", "SCAN objects", "SCAN jobs")) for step in plan), plan
    database.close()


def test_a_backup_keeps_whose_everything_is_and_a_bundle_for_another_service_does_not(
    empty: Store, tmp_path: Path
) -> None:
    migrate(empty.database)
    with acting_for("cell"):
        robot = empty.make(b"mesh")
    back_up(empty.database, empty.objects, tmp_path / "backup")
    export_robot(empty.database, empty.objects, robot.id, tmp_path / "bundle.zip")
    with zipfile.ZipFile(tmp_path / "bundle.zip") as bundle:
        bundle.extractall(tmp_path / "bundle")
    (resources,) = (tmp_path / "bundle").glob("tables*/resources.jsonl")
    assert "cell" not in resources.read_text()
    # One that says whose it is all the same gives nobody anything to pay for.
    (of_all,) = (tmp_path / "backup").glob("tables-*/resources.jsonl")
    resources.write_text(of_all.read_text())
    for name, owner in (("backup", "cell"), ("bundle", None)):
        database = Database(f"sqlite:///{tmp_path / name}.sqlite3")
        migrate(database)
        objects = ObjectStore((tmp_path / f"{name}-objects").as_uri(), tmp_path / "cache")
        if name == "backup":
            restore(database, objects, tmp_path / name, tmp_path)
        else:
            import_robot(database, objects, tmp_path / name, tmp_path, look_at=lambda one: None)
        with database.read() as session:
            assert compute_all_usage(session) == {owner: Usage(bytes=4)}
        database.close()
