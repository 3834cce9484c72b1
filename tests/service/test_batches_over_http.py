"""Many identifications in one request: all of them are accepted, or none."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of, wait_for
from sqlalchemy import event
from support.measurement_uploads import as_csv, sound, upload

from dynident_service.problems import ProblemError
from dynident_service.settings import Settings
from dynident_service.storage.database import Database, migrate
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import Dependency, NewJob, NewResource
from dynident_service.storage.resource_repository import Resources

PATH = "/v1/identifications/batch"
ROBOT = {"name": "two joints", "description": {"format": "modified_dh", "content": TWO_JOINTS}}


@pytest.fixture
def body(client: TestClient, robot: dict[str, Any]) -> dict[str, Any]:
    """What identifies a robot from its recording."""
    return {"robot_id": robot["id"], "measurement_ids": [upload(client, robot, as_csv(sound())).json()["id"]]}


@pytest.fixture
def idle(tmp_path: Path) -> Iterator[TestClient]:
    """A service that does no job, and whose database is its own."""
    app = app_of(Settings(data_dir=tmp_path, workers=1))
    with TestClient(app, "http://127.0.0.1", raise_server_exceptions=False) as client:
        app.state.services.engine.drain()
        yield client


def number_of(client: TestClient, path: str = "/v1/identifications") -> int:
    return len(client.get(path, params={"limit": 500}).json()["items"])


def test_each_identification_of_a_batch_is_one_as_any_other(client: TestClient, body: dict[str, Any]) -> None:
    names = ["first", "second", "third"]
    answer = client.post(PATH, json={"items": [{**body, "name": name} for name in names]})
    assert answer.status_code == 202, answer.text
    batch = answer.json()
    assert answer.headers["location"] == f"{PATH}/{batch['id']}"
    assert len({item["job_id"] for item in batch["items"]}) == 3
    shown = [client.get(f"/v1/identifications/{item['id']}").json() for item in batch["items"]]
    assert [one["name"] for one in shown] == names
    assert [one["job_id"] for one in shown] == [item["job_id"] for item in batch["items"]]

    def done() -> bool:
        return bool(client.get(f"{PATH}/{batch['id']}").json()["states"] == {"succeeded": 3})

    wait_for(done, timeout=90)
    assert client.get(f"/v1/identifications/{batch['items'][2]['id']}").json()["result"]["parameters"]


def test_one_that_cannot_be_accepted_keeps_all_out_and_every_wrong_one_is_named(
    client: TestClient, body: dict[str, Any]
) -> None:
    before = number_of(client), number_of(client, "/v1/jobs")
    wrong = [
        body,
        {**body, "robot_id": "rob_nothing"},
        body,
        {**body, "measurement_ids": [*body["measurement_ids"], "mea_nothing"]},
        {**body, "effects": [{"effect": "rigid_body"}, {"effect": "coulomb", "joints": ["wrist"]}]},
    ]
    answer = client.post(PATH, json={"items": wrong})
    assert answer.status_code == 422
    problem = answer.json()
    assert [error["pointer"] for error in problem["errors"]] == [
        "/items/1/robot_id",
        "/items/3/measurement_ids/1",
        "/items/4/effects/1",
    ]
    assert problem["detail"].startswith(
        "3 of 5 cannot be accepted, so none was accepted: /items/1/robot_id: there is no robot"
    )
    assert (number_of(client), number_of(client, "/v1/jobs")) == before


def test_a_field_that_does_not_fit_has_its_place_in_the_batch(client: TestClient, body: dict[str, Any]) -> None:
    answer = client.post(PATH, json={"items": [body, {**body, "measurement_ids": []}, {**body, "wheels": 3}]})
    assert [error["pointer"] for error in answer.json()["errors"]] == ["/items/1/measurement_ids", "/items/2/wheels"]
    assert client.post(PATH, json={"items": []}).status_code == 422


def test_a_batch_beyond_the_setting_is_refused_with_its_name(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, max_batch=2)
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        item = {"robot_id": "rob_x", "measurement_ids": ["mea_x"]}
        answer = client.post(PATH, json={"items": [item] * 3})
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/items")
    assert "3 are more than 2 (DYNIDENT_MAX_BATCH)" in answer.json()["detail"]


def test_a_retry_of_a_batch_makes_nothing_twice(client: TestClient, body: dict[str, Any]) -> None:
    headers = {"Idempotency-Key": f"batch {body['robot_id']}"}
    first = client.post(PATH, json={"items": [body, body]}, headers=headers)
    again = client.post(PATH, json={"items": [body, body]}, headers=headers)
    assert again.headers["idempotency-replayed"] == "true"
    assert again.headers["location"] == first.headers["location"]
    assert [item["id"] for item in again.json()["items"]] == [item["id"] for item in first.json()["items"]]
    listed = client.get("/v1/identifications", params={"robot_id": body["robot_id"]}).json()["items"]
    assert len(listed) == 2
    other = client.post(PATH, json={"items": [body]}, headers=headers)
    assert (other.status_code, other.json()["title"]) == (422, "Idempotency-Key used twice")


def test_what_says_that_they_were_asked_for_together_can_go_before_or_after_them(
    idle: TestClient, body_of_idle: dict[str, Any]
) -> None:
    batch = idle.post(PATH, json={"items": [body_of_idle] * 3}).json()
    assert batch["states"] == {"queued": 3}
    first, second, third = batch["items"]
    idle.post(f"/v1/jobs/{first['job_id']}/cancel")
    assert idle.delete(f"/v1/identifications/{first['id']}").status_code == 204
    idle.post(f"/v1/jobs/{second['job_id']}/cancel")
    left = idle.get(f"{PATH}/{batch['id']}").json()
    assert left["states"] == {"cancelled": 1, "queued": 1}
    assert [item["id"] for item in left["items"]] == [second["id"], third["id"]]
    assert idle.delete(f"{PATH}/{batch['id']}").status_code == 204
    assert idle.get(f"{PATH}/{batch['id']}").status_code == 404
    assert idle.get(f"/v1/identifications/{third['id']}").status_code == 200


def test_a_batch_is_cancelled_whole_and_what_has_ended_stays(idle: TestClient, body_of_idle: dict[str, Any]) -> None:
    batch, other = (idle.post(PATH, json={"items": [body_of_idle] * 3}).json() for _ in range(2))
    ledger: JobQueue = idle.app.state.services.job_queue  # type: ignore[attr-defined]
    ended, running = ledger.claim(2)
    ledger.record_success(ended, lambda session: None)
    for _ in range(2):
        cancelled = idle.post(f"{PATH}/{batch['id']}/cancel")
        assert cancelled.status_code == 200, cancelled.text
        assert cancelled.json()["states"] == {"succeeded": 1, "running": 1, "cancelled": 1}
    assert ledger.get_standing(running) == "cancel"
    last = cancelled.json()["items"][2]["job_id"]
    events = [event.data for event in ledger.read_events(last)[0]]
    assert events == [{"state": "queued"}, {"state": "cancelled"}]
    assert idle.get(f"/v1/jobs/{last}").json()["finished_at"] is not None
    assert idle.get(f"{PATH}/{other['id']}").json()["states"] == {"queued": 3}
    assert idle.post(f"{PATH}/bat_nothing/cancel").status_code == 404


def test_a_recording_deleted_in_the_last_moment_keeps_all_out(
    idle: TestClient, body_of_idle: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    write = Database.write

    def late(self: Database) -> Any:
        monkeypatch.setattr(Database, "write", write)
        assert idle.delete(f"/v1/measurements/{body_of_idle['measurement_ids'][0]}").status_code == 204
        return write(self)

    monkeypatch.setattr(Database, "write", late)
    answer = idle.post(PATH, json={"items": [body_of_idle] * 2})
    assert (answer.status_code, answer.json()["errors"][0]["pointer"]) == (422, "/items/0/measurement_ids/0")
    assert number_of(idle) == 0


def test_more_of_them_ask_the_database_no_more_often(idle: TestClient, body_of_idle: dict[str, Any]) -> None:
    asked: list[str] = []
    database: Database = idle.app.state.services.database  # type: ignore[attr-defined]

    def note(connection: Any, cursor: Any, statement: str, *_: Any) -> None:
        if "retries" not in statement and "api_keys" not in statement:
            asked.append(statement)

    def questions(number: int) -> int:
        asked.clear()
        assert idle.post(PATH, json={"items": [body_of_idle] * number}).status_code == 202
        return len([one for one in asked if one.startswith(("SELECT", "INSERT")) and "FROM jobs" not in one])

    event.listen(database.engine, "before_cursor_execute", note)
    try:
        assert questions(50) <= questions(2) + 2
    finally:
        event.remove(database.engine, "before_cursor_execute", note)


@pytest.mark.parametrize("kind", ["sqlite", "postgresql"])
def test_all_or_none_are_stored_on_either_database(request: pytest.FixtureRequest, tmp_path: Path, kind: str) -> None:
    on_disk = f"sqlite:///{tmp_path / 'batches.sqlite3'}"
    database = Database(on_disk if kind == "sqlite" else str(request.getfixturevalue("postgresql")))
    try:
        migrate(database)
        stored = Resources(database, ObjectStore(f"file://{tmp_path}/objects", tmp_path / "cache"))
        robot = stored.create(NewResource("robot", {}, name="arm")).id

        def of(*robots: str) -> list[NewResource]:
            needs = [
                Dependency(one, "robot", "robot", f"/items/{number}/robot_id") for number, one in enumerate(robots)
            ]
            job = NewJob("identification", "small_jobs:answer")
            return [NewResource("identification", {}, rests_on=(need,), job=job) for need in needs]

        made = stored.create_together(of(robot, robot), lambda ids: NewResource("batch", {}, result={"ids": ids}))
        assert made.result is not None
        found = stored.find_all(made.result["ids"])
        assert [found[one].get_dependency("robot") for one in made.result["ids"]] == [robot, robot]
        with pytest.raises(ProblemError) as refused:
            stored.create_together(of(robot, "rob_nothing"), lambda ids: NewResource("batch", {}))
        assert refused.value.problem.errors is not None
        assert refused.value.problem.errors[0].pointer == "/items/1/robot_id"
        assert len(stored.list_page("identification", 500, on_id=robot).items) == 2
        for one in found:  # other tests on this database claim whatever is queued
            assert found[one].job is not None
            JobQueue(database).cancel(found[one].job.id)
    finally:
        database.close()


@pytest.mark.slow
@pytest.mark.parametrize("robots", [1, 100, pytest.param(1000, marks=pytest.mark.thorough)])
def test_a_thousand_are_accepted_while_others_are_answered(
    idle: TestClient, body_of_idle: dict[str, Any], robots: int
) -> None:
    ids = [body_of_idle["robot_id"], *(idle.post("/v1/robots", json=ROBOT).json()["id"] for _ in range(robots - 1))]
    items = [{**body_of_idle, "robot_id": ids[number % robots], "name": f"{number}"} for number in range(1000)]
    began = time.perf_counter()
    answer = idle.post(PATH, json={"items": items})
    took = time.perf_counter() - began
    assert answer.status_code == 202, answer.text
    assert answer.json()["states"] == {"queued": 1000}
    print(f"1000 identifications of {robots} robots were accepted within {took:.2f} s")
    assert took < 20


@pytest.fixture
def body_of_idle(idle: TestClient) -> dict[str, Any]:
    robot = idle.post("/v1/robots", json=ROBOT).json()
    return {"robot_id": robot["id"], "measurement_ids": [upload(idle, robot, as_csv(sound())).json()["id"]]}
