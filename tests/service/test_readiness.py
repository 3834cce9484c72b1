"""`/readyz` asks what users ask, and a service ends though its database hangs."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest
from fastapi.testclient import TestClient
from service_helpers import app_of, free_port, wait_for

from dynident_service import readiness
from dynident_service.settings import Settings
from dynident_service.storage_and_engine import Services

SERVICE = Path(__file__).with_name("service_whose_database_hangs.py")
STUCK = 20


@pytest.fixture
def own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[TestClient]:
    """A service whose answers on readiness are not remembered."""
    monkeypatch.setattr(readiness, "FRESH", 0.0)
    with TestClient(app_of(Settings(data_dir=tmp_path, workers=1, request_workers=1)), "http://127.0.0.1") as client:
        wait_for(lambda: client.get("/readyz").json()["checks"]["computations"] == "ok")
        yield client


@pytest.fixture
def own_services(own: TestClient) -> Services:
    services: Services = own.app.state.services  # type: ignore[attr-defined]
    return services


def test_a_child_that_does_not_answer_makes_the_service_not_ready(own: TestClient, own_services: Services) -> None:
    (child,) = own_services.interactive._pool._idle
    assert child.pid is not None
    os.kill(child.pid, signal.SIGSTOP)
    began = time.monotonic()
    answer = own.get("/readyz")
    assert answer.status_code == 503
    assert answer.json()["checks"]["computations"] == "failed: no answer within 1 s"
    assert own.get("/readyz").status_code == 503
    assert time.monotonic() - began < 2 * readiness.LONGEST  # the second is told what the first waits for
    os.kill(child.pid, signal.SIGCONT)
    wait_for(lambda: own.get("/readyz").status_code == 200)


def test_a_database_that_refuses_makes_the_service_not_ready(
    own: TestClient, own_services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse() -> None:
        raise OSError("no such disk")

    monkeypatch.setattr(own_services.database, "read", refuse)
    answer = own.get("/readyz")
    assert (answer.status_code, answer.json()["checks"]["database"]) == (503, "failed: OSError")


def test_readiness_is_asked_once_a_second_however_many_ask(
    own: TestClient, own_services: Services, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readiness, "FRESH", 60.0)
    asked: list[object] = []
    read = own_services.database.read

    def count_and_read() -> object:
        # The engine looks for jobs in the same database, every few moments.
        if sys._getframe(1).f_globals["__name__"] == readiness.__name__:
            asked.append(None)
        return read()

    monkeypatch.setattr(own_services.database, "read", count_and_read)
    assert {own.get("/readyz").status_code for _ in range(20)} == {200}
    assert len(asked) <= 1


def test_a_service_says_that_it_starts_until_the_first_child_has_answered(tmp_path: Path) -> None:
    with TestClient(app_of(Settings(data_dir=tmp_path, workers=1)), "http://127.0.0.1") as client:
        services: Services = client.app.state.services  # type: ignore[attr-defined]
        for child in services.interactive._pool._idle:
            wait_for(lambda child=child: child.is_alive() and child.pid)
            os.kill(child.pid, signal.SIGSTOP)
        answer = client.get("/readyz")
        assert (answer.status_code, answer.json()["checks"]["computations"]) == (200, "starting")


def test_a_service_whose_database_hangs_is_not_ready_and_ends_when_it_is_told_to(tmp_path: Path) -> None:
    port, hangs = free_port(), tmp_path / "hangs"
    variables = {
        "DYNIDENT_DATA_DIR": str(tmp_path / "data"),
        "DYNIDENT_PORT": str(port),
        "DYNIDENT_WORKERS": "1",
        "DYNIDENT_DRAIN_SECONDS": "1",
        "HANGS": str(hangs),
    }
    process = subprocess.Popen([sys.executable, SERVICE], env={**os.environ, **variables}, stderr=subprocess.PIPE)
    try:
        client = httpx2.Client(base_url=f"http://127.0.0.1:{port}", timeout=10)
        wait_for(lambda: status_of(client, "/readyz") == 200, timeout=60)
        hangs.touch()
        threads = [threading.Thread(target=status_of, args=(client, "/v1/robots"), daemon=True) for _ in range(STUCK)]
        for thread in threads:
            thread.start()
        wait_for(lambda: status_of(client, "/readyz") == 503)
        began = time.monotonic()
        answer: Any = client.get("/readyz").json()
        assert "no answer within 1 s" in answer["checks"]["database"]
        assert status_of(client, "/healthz") == 200
        assert time.monotonic() - began < 2 * readiness.LONGEST
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=20) == 1
        assert process.stderr is not None
        assert b"does not end by itself" in process.stderr.read()
    finally:
        process.kill()
        process.wait()


def status_of(client: httpx2.Client, path: str) -> int | None:
    try:
        return int(client.get(path).status_code)
    except httpx2.HTTPError:
        return None
