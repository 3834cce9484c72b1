"""PostgreSQL instead of SQLite, and a Dask cluster of its own instead of one inside the service."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest
from alembic import command
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, free_port, wait_for

from dynident_service.app import create_app
from dynident_service.services import Services
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.ledger import Ledger
from dynident_service.storage.migrate import configuration, migrate
from dynident_service.storage.records import NewJob

pytestmark = pytest.mark.slow

JOB = NewJob("report", "small_jobs:answer")


def test_postgresql_keeps_the_same_tables_and_takes_no_job_twice(postgresql: str) -> None:
    database = Database(postgresql)
    migrate(database)
    with database.engine.connect() as connection:
        command.check(configuration(connection))
    for _ in range(100):
        Ledger(database).enqueue(JOB)
    taken: list[str] = []

    def take() -> None:
        mine = Database(postgresql)
        ledger = Ledger(mine)
        while claims := ledger.claim(slots=1000):
            for claim in claims:
                taken.append(claim.job_id)
                ledger.succeed(claim, lambda session: None)
        mine.close()

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(taken) == len(set(taken)) == 100
    database.close()


def test_the_service_works_on_postgresql(postgresql: str, tmp_path: Path) -> None:
    settings = Settings(data_dir=tmp_path, database_url=postgresql, workers=1)
    with TestClient(create_app(settings), "http://127.0.0.1", raise_server_exceptions=False) as client:
        body = {"name": "arm", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
        first, second = (client.post("/v1/robots", json=body, headers={"Idempotency-Key": "k"}) for _ in range(2))
        assert first.json() == second.json()
        assert run_a_job(client) == "succeeded"
        assert client.delete(first.headers["location"]).status_code == 204


def test_jobs_run_on_a_cluster_elsewhere(tmp_path: Path) -> None:
    port = free_port()
    address = f"tcp://127.0.0.1:{port}"
    environment = {**os.environ, "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error"}
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "env": environment}
    dashboard = ["--dashboard-address", "127.0.0.1:0"]
    scheduler = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "distributed.cli.dask_scheduler",
            "--host",
            "127.0.0.1",
            "--port",
            str(port),
            *dashboard,
        ],
        **quiet,
    )
    worker = subprocess.Popen(
        [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", *dashboard],
        cwd=tmp_path,
        **quiet,
    )
    try:
        settings = Settings(data_dir=tmp_path, dask_scheduler=address)
        with TestClient(create_app(settings), "http://127.0.0.1") as client:
            assert run_a_job(client) == "succeeded"
            worker.kill()
            job_id = enqueue(client)
            worker.wait()
            worker = subprocess.Popen(worker.args, cwd=tmp_path, **quiet)
            assert wait_for(lambda: ended(client, job_id), timeout=60) == "succeeded"
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.wait()


def run_a_job(client: TestClient) -> Any:
    job_id = enqueue(client)
    return wait_for(lambda: ended(client, job_id), timeout=60)


def enqueue(client: TestClient) -> str:
    services: Services = client.app.state.services  # type: ignore[attr-defined]
    job_id = services.ledger.enqueue(JOB)
    services.engine.nudge()
    return job_id


def ended(client: TestClient, job_id: str) -> Any:
    state = client.get(f"/v1/jobs/{job_id}").json()["state"]
    return state if state in ("succeeded", "failed", "cancelled") else None
