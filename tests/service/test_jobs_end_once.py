"""Jobs beside a database that hiccups, processes that stop, and computations that never end."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from fork_servers import HEARTBEAT
from service_helpers import app_of, wait_for
from sqlalchemy.exc import OperationalError

from dynident_service.jobs import job_engine as engine_module
from dynident_service.jobs import job_supervisor
from dynident_service.jobs.job_engine import LocalExecutor
from dynident_service.settings import Settings
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.repository_values import NewJob
from dynident_service.storage_and_engine import Services

Start = Callable[..., str]
Wait = Callable[..., Any]


STILL_FOR = 3 * HEARTBEAT


@pytest.fixture
def soon_still(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(job_supervisor, "STILL_FOR", STILL_FOR)
    monkeypatch.setattr(job_supervisor, "VITALS", 0.2)


@pytest.mark.parametrize("name", ["get_standing", "renew"])
def test_a_database_away_for_a_moment_does_not_end_a_job_that_is_watched(
    start: Start, wait: Wait, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    monkeypatch.setattr(job_supervisor, "RENEW", 0.1 if name == "renew" else 60.0)
    monkeypatch.setattr(job_supervisor, "AWAY_PAUSE", 0.05)
    method = getattr(JobQueue, name)
    calls = 0

    def flaky(self: JobQueue, *arguments: Any) -> Any:
        nonlocal calls
        calls += 1
        if calls in (2, 3, 5):
            raise OperationalError("SELECT", {}, Exception("database is locked"))
        return method(self, *arguments)

    monkeypatch.setattr(JobQueue, name, flaky)
    job = wait(start("count", steps=10, pause=0.2))
    assert (job.state, job.attempt) == ("succeeded", 1)
    assert calls > 5


def test_a_database_away_for_a_moment_does_not_end_a_job_that_reports_and_stores(start: Start, wait: Wait) -> None:
    job = wait(start("meets_a_hiccup", times=3))
    assert (job.state, job.attempt) == ("succeeded", 1)


def test_a_job_that_lost_the_database_in_its_middle_is_begun_again_and_not_blamed(
    start: Start, wait: Wait, tmp_path: Path
) -> None:
    job = wait(start("loses_the_database", note=str(tmp_path / "note")))
    assert (job.state, job.attempt) == ("succeeded", 2)


def test_a_job_whose_store_refuses_for_minutes_is_begun_again_more_and_more_seldom_and_cancelled_at_once(
    start: Start, wait: Wait, services: Services
) -> None:
    job_id = start("meets_a_store_that_refuses")
    time.sleep(5.0)
    job = services.job_queue.get(job_id)
    assert job.state in ("queued", "running")  # and not given up
    assert 2 <= job.attempt <= 6
    wait_for(lambda: services.job_queue.get(job_id).state == "running", 20.0)
    services.job_queue.cancel(job_id)
    assert wait(job_id, 2.0).state == "cancelled"


def test_a_process_that_is_stopped_is_noticed_and_its_job_done_by_another(
    start: Start, wait: Wait, services: Services, soon_still: None, tmp_path: Path
) -> None:
    note, go = tmp_path / "pid", tmp_path / "go"
    job_id = start("waits", note=str(note), go=str(go))
    for stops in range(services.settings.max_attempts):
        pid = int(wait_for(lambda: note.exists() and note.read_text()))
        note.unlink()
        os.kill(pid, signal.SIGSTOP)
        wait_for(lambda stops=stops: services.job_queue.get(job_id).attempt == stops + 2)
    go.touch()
    assert wait(job_id).state == "succeeded"


def test_a_computation_that_stands_still_is_given_up_with_the_reason(
    start: Start, wait: Wait, soon_still: None
) -> None:
    job = wait(start("stands_still"), timeout=60)
    assert job.state == "failed"
    assert "made no progress" in job.error["detail"]


def test_a_solver_that_says_nothing_but_computes_is_left_alone(start: Start, wait: Wait, soon_still: None) -> None:
    numbers, took = 10**8, 0.0
    while took < 1.5 * STILL_FOR:  # longer than a process may stand still
        began = time.monotonic()
        job = wait(start("holds_the_interpreter", numbers=numbers), timeout=120)
        assert (job.state, job.attempt) == ("succeeded", 1)
        took, numbers = time.monotonic() - began, 4 * numbers


def test_a_computation_beyond_its_deadline_is_stopped_and_said_so(tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, workers=1, job_deadline_seconds=1.0)
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        arguments = {"note": str(tmp_path / "note"), "go": str(tmp_path / "never")}
        job_id = services.job_queue.enqueue(NewJob("report", "small_jobs:waits", arguments))
        services.engine.wake()
        job = wait_for(
            lambda: services.job_queue.get(job_id).finished_at and services.job_queue.get(job_id), timeout=60
        )
    assert job.state == "failed"
    assert "DYNIDENT_JOB_DEADLINE_SECONDS" in job.error["detail"]


def test_an_engine_that_cannot_start_its_processes_tries_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tries: list[float] = []
    enter = LocalExecutor.__enter__

    def too_late(self: LocalExecutor) -> LocalExecutor:
        tries.append(time.monotonic())
        if len(tries) < 3:
            raise OSError("no process can be started")
        return enter(self)

    monkeypatch.setattr(LocalExecutor, "__enter__", too_late)
    monkeypatch.setattr(engine_module, "FIRST_PAUSE", 0.2)
    with TestClient(app_of(Settings(data_dir=tmp_path, workers=1)), "http://127.0.0.1") as client:
        wait_for(lambda: client.get("/readyz").status_code == 503)
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        job_id = services.job_queue.enqueue(NewJob("report", "small_jobs:answer"))
        wait_for(lambda: services.job_queue.get(job_id).state == "succeeded", timeout=60)
        assert client.get("/readyz").status_code == 200
