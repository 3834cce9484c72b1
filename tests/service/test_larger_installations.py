"""PostgreSQL instead of SQLite, and a Dask cluster of its own instead of one inside the service."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from dask_cluster import Cluster, wrong_clock
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, app_of, let_leases_run_out, wait_for
from sqlalchemy import event, text

from dynident_service.problems import make_problem
from dynident_service.settings import Settings
from dynident_service.storage import job_queue as ledger_module
from dynident_service.storage.database import Database, build_alembic_config, migrate
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.repository_values import FINAL, NewJob
from dynident_service.storage_and_engine import Services

pytestmark = pytest.mark.slow

JOB = NewJob("report", "small_jobs:answer")


def test_postgresql_keeps_the_same_tables_and_takes_no_job_twice(postgresql: str) -> None:
    database = Database(postgresql)
    migrate(database)
    with database.engine.connect() as connection:
        command.check(build_alembic_config(connection))
    for _ in range(100):
        JobQueue(database).enqueue(JOB)
    taken: list[str] = []

    def take() -> None:
        mine = Database(postgresql)
        ledger = JobQueue(mine)
        while claims := ledger.claim(slots=1000):
            for claim in claims:
                taken.append(claim.job_id)
                ledger.record_success(claim, lambda session: None)
        mine.close()

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(taken) == len(set(taken)) == 100
    database.close()


def test_who_follows_a_job_that_ends_just_then_is_told_the_end_with_the_last_event_or_after_it(postgresql: str) -> None:
    database = Database(postgresql)
    migrate(database)
    ledger = JobQueue(database)
    job_id = ledger.enqueue(JOB)
    (claim,) = ledger.claim(slots=1)
    ending = threading.Event()

    def end(*_: Any) -> None:
        if not ending.is_set():
            ending.set()
            ledger.record_failure(claim, make_problem(422, "no rows are left"))

    event.listen(database.engine, "after_cursor_execute", end)
    try:
        events, is_over = ledger.read_events(job_id)
    finally:
        event.remove(database.engine, "after_cursor_execute", end)
    assert ending.is_set()
    assert is_over == (events[-1].data["state"] == "failed")
    later, is_over = ledger.read_events(job_id, after=events[-1].id)
    assert is_over
    assert [one.data["state"] for one in (*events, *later)] == ["queued", "running", "failed"]
    database.close()


def test_the_service_works_on_postgresql(postgresql: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=postgresql, workers=1)
    with TestClient(app_of(settings), "http://127.0.0.1", raise_server_exceptions=False) as client:
        body = {"name": "arm", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
        first, second = (client.post("/v1/robots", json=body, headers={"Idempotency-Key": "k"}) for _ in range(2))
        assert first.json() == second.json()
        assert run_a_job(client) == "succeeded"
        assert client.delete(first.headers["location"]).status_code == 204


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    made = Cluster(tmp_path)
    yield made
    made.end()


@pytest.fixture
def soon_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the service hands out that never arrives is missed sooner."""
    monkeypatch.setattr(ledger_module, "FIRST_LEASE", timedelta(seconds=10))


def test_jobs_run_on_a_cluster_elsewhere(cluster: Cluster, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, dask_scheduler=cluster.address)
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        assert run_a_job(client) == "succeeded"
        cluster.worker.kill()
        job_id = enqueue(client)
        cluster.worker.wait()
        cluster.new_worker()
        assert wait_for(lambda: ended(client, job_id), timeout=90) == "succeeded"


def test_a_worker_that_is_told_to_terminate_gives_its_job_back_at_once(cluster: Cluster, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, dask_scheduler=cluster.address)
    note, go = tmp_path / "pid", tmp_path / "go"
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        job_id = services.job_queue.enqueue(NewJob("report", "small_jobs:waits", {"note": str(note), "go": str(go)}))
        wait_for(note.exists, timeout=60)
        old = cluster.worker
        old.terminate()
        # Sooner than a lease runs out. The state itself may be "running" again at once: until the cluster is looked
        # at anew, the engine takes the worker for one that is there.
        wait_for(lambda: times_queued(services, job_id) == 2, timeout=15)
        old.wait(timeout=30)
        go.touch()
        cluster.new_worker()
        assert wait_for(lambda: ended(client, job_id), timeout=90) == "succeeded"
        strain = services.job_queue.measure_health()
    assert (strain.deaths, strain.losses) == (0, 0)


def test_a_restarted_scheduler_is_noticed_and_jobs_go_on(cluster: Cluster, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, dask_scheduler=cluster.address)
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        assert run_a_job(client) == "succeeded"
        assert client.get("/readyz").status_code == 200
        cluster.end()
        wait_for(lambda: client.get("/readyz").status_code == 503, timeout=60)
        assert "failed" in client.get("/readyz").json()["checks"]["engine"]
        job_id = enqueue(client)
        cluster.new_scheduler()
        wait_for(lambda: client.get("/readyz").json()["checks"]["engine"] == "without workers", timeout=60)
        assert client.get("/readyz").status_code == 503
        cluster.new_worker()
        wait_for(lambda: client.get("/readyz").status_code == 200, timeout=60)
        assert wait_for(lambda: ended(client, job_id), timeout=60) == "succeeded"
        assert client.get(f"/v1/jobs/{job_id}").json()["attempt"] == 1


def test_a_scheduler_restarted_at_once_with_new_workers_is_no_harm(
    cluster: Cluster, soon_missed: None, tmp_path: Path
) -> None:
    settings = Settings(data_dir=tmp_path, dask_scheduler=cluster.address)
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        assert run_a_job(client) == "succeeded"
        cluster.end()
        cluster.new_scheduler()
        cluster.new_worker()
        assert run_a_job(client) == "succeeded"


@pytest.mark.parametrize("with_its_worker", [pytest.param(False, marks=pytest.mark.thorough), True])
def test_a_scheduler_killed_in_the_middle_of_a_job_ends_it_once(
    cluster: Cluster, soon_missed: None, tmp_path: Path, with_its_worker: bool
) -> None:
    settings = Settings(data_dir=tmp_path, dask_scheduler=cluster.address)
    note, go = tmp_path / "pid", tmp_path / "go"
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        job_id = services.job_queue.enqueue(NewJob("report", "small_jobs:waits", {"note": str(note), "go": str(go)}))
        wait_for(note.exists, timeout=60)
        waiting = [enqueue(client) for _ in range(5)]
        cluster.scheduler.send_signal(signal.SIGKILL)
        cluster.scheduler.wait()
        if with_its_worker:
            cluster.worker.kill()
            cluster.worker.wait()
            let_leases_run_out(services.database)
        cluster.new_scheduler()
        go.touch()
        cluster.new_worker()
        for one in (job_id, *waiting):
            assert wait_for(lambda one=one: ended(client, one), timeout=120) == "succeeded"
            assert times_ended(services, one) == 1
        assert services.job_queue.measure_health().deaths == 0


@pytest.mark.parametrize("seconds_off", [-600, pytest.param(600, marks=pytest.mark.thorough)])
def test_a_worker_whose_clock_is_wrong_keeps_its_job(
    cluster: Cluster, postgresql: str, tmp_path: Path, seconds_off: int
) -> None:
    cluster.worker.kill()
    cluster.worker.wait()
    cluster.new_worker(**wrong_clock(tmp_path, seconds_off))
    settings = Settings(data_dir=tmp_path, database_url=postgresql, dask_scheduler=cluster.address)
    note = tmp_path / "time"
    # Longer than its lease is renewed, and than one that ran out is looked at twice.
    asked = {"steps": 100, "pause": 0.15, "note": str(note)}
    with TestClient(app_of(settings), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        job_id = services.job_queue.enqueue(NewJob("report", "small_jobs:counts_and_tells_the_time", asked))
        job = wait_for(lambda: ended_of(services, job_id), timeout=120)
        assert (job.state, job.attempt, times_ended(services, job_id)) == ("succeeded", 1, 1)
        for told in (job.started_at, job.finished_at):
            assert abs((datetime.now(UTC) - told).total_seconds()) < 120
    assert abs(float(note.read_text()) - time.time() - seconds_off) < 60  # its clock was wrong indeed


def times_ended(services: Services, job_id: str) -> int:
    return sum(event.data.get("state") in FINAL for event in services.job_queue.read_events(job_id)[0])


def times_queued(services: Services, job_id: str) -> int:
    return sum(event.data.get("state") == "queued" for event in services.job_queue.read_events(job_id)[0])


def run_a_job(client: TestClient) -> Any:
    job_id = enqueue(client)
    return wait_for(lambda: ended(client, job_id), timeout=120)


def enqueue(client: TestClient) -> str:
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    job_id = services.job_queue.enqueue(JOB)
    services.engine.wake()
    return job_id


def ended(client: TestClient, job_id: str) -> Any:
    state = client.get(f"/v1/jobs/{job_id}").json()["state"]
    return state if state in ("succeeded", "failed", "cancelled") else None


def test_connections_that_are_cut_again_and_again_end_no_job(postgresql: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=postgresql, workers=1)
    cutter = Database(postgresql)
    with TestClient(app_of(settings), "http://127.0.0.1", raise_server_exceptions=False) as client:
        assert run_a_job(client) == "succeeded"
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        job_id = services.job_queue.enqueue(NewJob("report", "small_jobs:count", {"steps": 40}))
        services.engine.wake()
        cut = text("SELECT pg_terminate_backend(pid) FROM pg_stat_activity WHERE pid <> pg_backend_pid()")
        for _ in range(20):
            with cutter.engine.connect() as connection:
                connection.execute(cut)
            time.sleep(0.2)
        job = wait_for(lambda: ended_of(services, job_id), timeout=60)
        assert (job.state, job.attempt) == ("succeeded", 1)
    cutter.close()


def test_leases_are_by_the_clock_of_the_database(postgresql: str, monkeypatch: pytest.MonkeyPatch) -> None:
    class Early(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> datetime:  # type: ignore[override]
            return datetime.now(tz) - timedelta(minutes=10)

    database = Database(postgresql)
    migrate(database)
    ledger = JobQueue(database)
    job_id = ledger.enqueue(JOB)
    for module in ("database", "database_tables"):
        monkeypatch.setattr(f"dynident_service.storage.{module}.datetime", Early)
    claims = ledger.claim(1000)
    monkeypatch.undo()
    (claim,) = (one for one in claims if one.job_id == job_id)
    started = ledger.get(job_id).started_at
    assert started is not None
    assert abs((datetime.now(UTC) - started).total_seconds()) < 60
    ledger.record_success(claim, lambda session: None)
    for other in claims:
        ledger.release(other)
    database.close()


def ended_of(services: Services, job_id: str) -> Any:
    job = services.job_queue.get(job_id)
    return job if job.state in ("succeeded", "failed", "cancelled") else None
