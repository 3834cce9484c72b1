"""What the log says of requests and jobs, and under which ids."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of, wait_for
from sqlalchemy import select

from dynident_service.api_keys import create_key
from dynident_service.app import create_app
from dynident_service.settings import Settings
from dynident_service.storage.database_tables import JobRow
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import REQUEST
from dynident_service.storage.repository_values import NewJob
from dynident_service.storage_and_engine import Services
from dynident_service.tracing import FIELDS, configure_logging, set_current_request, set_log_context


@pytest.fixture
def told(caplog: pytest.LogCaptureFixture) -> Callable[[], list[dict[str, Any]]]:
    """Gives the fields of the lines that tell of requests."""
    caplog.set_level("INFO", logger="dynident.access")
    return lambda: [getattr(record, FIELDS) for record in caplog.records if record.name == "dynident.access"]


@contextmanager
def configured(form: Any) -> Iterator[None]:
    """The log of a process that begins."""
    root = logging.getLogger()
    before, level = root.handlers, root.level
    root.handlers = []
    configure_logging("info", form)
    try:
        yield
    finally:
        root.handlers = before
        root.setLevel(level)


def three_lines(form: Any, capsys: pytest.CaptureFixture[str]) -> list[str]:
    """What is written of a job that fails, and of something else."""
    job = logging.getLogger("dynident.job")
    with configured(form):
        with set_log_context("job_1", "req-1"):
            job.info("done with %s", "it")
            try:
                raise ValueError("no such joint")
            except ValueError:
                job.exception("failed")
        logging.getLogger("dynident.service").warning("on its own", extra={FIELDS: {"status": 503}})
    return capsys.readouterr().err.splitlines()


def test_every_answer_carries_an_id_of_its_request(client: TestClient) -> None:
    first, second = client.get("/healthz"), client.get("/v1/robots")
    assert len(first.headers["x-request-id"]) == 16
    assert first.headers["x-request-id"] != second.headers["x-request-id"]


def test_the_id_of_the_caller_is_kept_where_it_is_a_short_token(client: TestClient) -> None:
    kept = client.get("/v1/robots", headers={"x-request-id": "cell-5.run_12"})
    assert kept.headers["x-request-id"] == "cell-5.run_12"
    for strange in ("x" * 65, "two words", "-", "a;b", "<b>", "", "dïdent".encode()):
        answer = client.get("/v1/robots", headers={"x-request-id": strange})
        assert len(answer.headers["x-request-id"]) == 16


def test_a_problem_names_its_request(client: TestClient) -> None:
    headers = {"x-request-id": "mine"}
    for answer in (
        client.get("/v1/robots/rob_nothing", headers=headers),
        client.post("/v1/robots", json={}, headers=headers),
        client.get("/v1/robots", headers={**headers, "host": "robots.example"}),
    ):
        assert answer.json()["request_id"] == answer.headers["x-request-id"] == "mine"
    assert "request_id" not in client.get("/healthz").json()


def test_an_unexpected_failure_names_its_request_in_answer_and_log(
    settings: Settings, capsys: pytest.CaptureFixture[str]
) -> None:
    app = app_of(settings)

    @app.get("/breaks")
    def breaks() -> None:
        raise RuntimeError("secret of the machine room")

    client = TestClient(app, "http://127.0.0.1", raise_server_exceptions=False)
    with configured("json"):
        answer = client.get("/breaks", headers={"x-request-id": "mine"})
    assert answer.status_code == 500
    assert answer.json()["request_id"] == answer.headers["x-request-id"] == "mine"
    written = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    ours = [line for line in written if line["logger"].startswith("dynident")]
    assert {line["logger"] for line in ours} == {"dynident.access", "dynident.service"}
    assert {line["request_id"] for line in ours} == {"mine"}
    assert next(line["status"] for line in ours if line["logger"] == "dynident.access") == 500


def test_a_page_of_another_origin_may_read_the_id(tmp_path: Path) -> None:
    origin = "https://lab.example"
    with TestClient(app_of(Settings(data_dir=tmp_path, allowed_origins=[origin])), "http://127.0.0.1") as client:
        answer = client.get("/v1/robots", headers={"origin": origin})
    assert "X-Request-ID" in answer.headers["access-control-expose-headers"]
    assert answer.headers["x-request-id"]


def test_every_request_has_one_line_without_its_query(
    client: TestClient, told: Callable[[], list[dict[str, Any]]], caplog: pytest.LogCaptureFixture
) -> None:
    client.get("/v1/robots?limit=3&cursor=secret")
    client.delete("/v1/robots/rob_nothing%0Aforged")
    first, second = told()
    assert (first["method"], first["path"], first["status"], first["key"]) == ("GET", "/v1/robots", 200, None)
    assert 0 < first["milliseconds"] < 10_000
    assert (second["method"], second["path"], second["status"]) == ("DELETE", "/v1/robots/rob_nothing%0Aforged", 404)
    assert "secret" not in caplog.text


def test_the_line_has_the_name_of_the_key_and_never_the_key(
    tmp_path: Path, told: Callable[[], list[dict[str, Any]]], caplog: pytest.LogCaptureFixture
) -> None:
    settings = Settings(data_dir=tmp_path, require_keys=True, api_keys=["0123456789abcdef0123456789abcdef"])  # type: ignore[list-item]
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        key = create_key(client.app.state.services.database, "cell 5")  # type: ignore[attr-defined]
        client.get(f"/v1/robots?key={key}", headers={"x-api-key": key})
        client.get("/v1/robots", headers={"x-api-key": "wrong"})
    assert [(line["key"], line["status"]) for line in told()] == [("cell 5", 200), (None, 401)]
    assert key not in " ".join(record.getMessage() for record in caplog.records if record.name.startswith("dynident"))


def test_lines_of_json_are_one_object_each_with_the_ids_of_job_and_request(
    capsys: pytest.CaptureFixture[str],
) -> None:
    done, failed, alone = [json.loads(line) for line in three_lines("json", capsys)]
    assert done.pop("time").endswith("+00:00")
    ids = {"request_id": "req-1", "job_id": "job_1"}
    assert done == {"level": "info", "logger": "dynident.job", "message": "done with it", **ids}
    assert failed["level"] == "error"
    assert failed["exception"].endswith("ValueError: no such joint")
    assert (alone["message"], alone["status"]) == ("on its own", 503)
    assert not {"request_id", "job_id", "exception"} & set(alone)


def test_lines_of_text_say_the_same_for_people(capsys: pytest.CaptureFixture[str]) -> None:
    times, lines = zip(*(line.partition(" ")[::2] for line in three_lines("text", capsys)), strict=True)
    done, failed, *_, alone = lines
    assert all(datetime.fromisoformat(times[n]).tzinfo for n in (0, 1, -1))
    assert done == "INFO dynident.job: done with it [job job_1, request req-1]"
    assert failed == "ERROR dynident.job: failed [job job_1, request req-1]"
    assert alone == "WARNING dynident.service: on its own"


def test_a_job_knows_the_request_that_submitted_it_and_its_function_does_not(ledger: JobQueue) -> None:
    set_current_request("req-7")
    ledger.enqueue(NewJob("report", "small_jobs:answer", {"answer": 1}))
    (claim,) = ledger.claim(1)
    assert (claim.request_id, dict(claim.arguments)) == ("req-7", {"answer": 1})


def test_the_job_of_a_request_keeps_its_id(client: TestClient, services: Services, robot: dict[str, Any]) -> None:
    headers = {"x-request-id": "the-request"}
    made = client.post("/v1/designs", json={"robot_id": robot["id"]}, headers=headers).json()
    with services.database.read() as session:
        arguments = session.scalar(select(JobRow.arguments).where(JobRow.id == made["job_id"]))
    client.post(f"/v1/jobs/{made['job_id']}/cancel")
    assert arguments is not None
    assert arguments[REQUEST] == "the-request"


def test_the_process_of_a_job_tells_of_it_under_the_same_ids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("DYNIDENT_LOG_FORMAT", "json")
    with TestClient(create_app(Settings(data_dir=tmp_path, workers=1)), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        set_current_request("req-9")
        job_id = services.job_queue.enqueue(NewJob("report", "small_jobs:broken"))
        services.engine.wake()
        wait_for(lambda: services.job_queue.get(job_id).state == "failed", timeout=60)
    written = [json.loads(line) for line in capfd.readouterr().err.splitlines() if line.startswith("{")]
    (told,) = (line for line in written if line["logger"] == "dynident.job")
    assert (told["job_id"], told["request_id"]) == (job_id, "req-9")
    assert told["exception"].endswith("RuntimeError: secret of the machine room")
