from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from fastapi.testclient import TestClient
from service_helpers import TWO_JOINTS, wait_for

from dynident_client import Client
from dynident_service.app import create_app
from dynident_service.services import Services
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.ledger import Ledger
from dynident_service.storage.migrate import migrate
from dynident_service.storage.records import NewJob

HERE = Path(__file__).parent


@pytest.fixture(scope="session", autouse=True)
def _jobs_of_the_tests_can_be_imported_by_child_processes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH", "")])))
        yield


@pytest.fixture(scope="session")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return Settings(data_dir=tmp_path_factory.mktemp("service"), workers=2, max_upload_bytes=3_000_000)


@pytest.fixture(scope="session")
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(create_app(settings), "http://127.0.0.1", raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def services(client: TestClient) -> Services:
    found = client.app.state.services  # type: ignore[attr-defined]
    assert isinstance(found, Services)
    return found


@pytest.fixture
def ledger(tmp_path: Path) -> Iterator[Ledger]:
    """A ledger that no engine works on."""
    database = Database(f"sqlite:///{tmp_path / 'ledger.sqlite3'}")
    migrate(database)
    yield Ledger(database, max_attempts=2)
    database.close()


@pytest.fixture
def start(services: Services) -> Callable[..., str]:
    """Starts a small job; gives its id."""

    def begin(function: str, **arguments: Any) -> str:
        job_id = services.ledger.enqueue(NewJob("report", f"small_jobs:{function}", arguments))
        services.engine.nudge()
        return job_id

    return begin


@pytest.fixture
def wait(services: Services) -> Callable[..., Any]:
    """Waits until a job has ended."""

    def until_ended(job_id: str, timeout: float = 30.0) -> Any:
        return wait_for(lambda: _ended(services, job_id), timeout)

    return until_ended


@pytest.fixture
def robot(client: TestClient) -> dict[str, Any]:
    body = {"name": "two joints", "description": {"format": "modified_dh", "content": TWO_JOINTS}}
    answer = client.post("/v1/robots", json=body)
    assert answer.status_code == 201, answer.text
    return dict(answer.json())


def _ended(services: Services, job_id: str) -> Any:
    job = services.ledger.get(job_id)
    return job if job.state in ("succeeded", "failed", "cancelled") else None


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Client]:
    """A client of a service that listens on a port of its own."""
    settings = Settings(data_dir=tmp_path_factory.mktemp("live"), workers=2)
    server = uvicorn.Server(uvicorn.Config(create_app(settings), port=0, log_level="warning"))
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_for(lambda: server.started)
    port = server.servers[0].sockets[0].getsockname()[1]
    with Client(f"http://127.0.0.1:{port}") as client:
        yield client
    server.should_exit = True
    thread.join()
