from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
import uuid
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from installations import installed, temporary_database
from service_helpers import SCIENCE, TWO_JOINTS, app_of, free_port, wait_for
from sqlalchemy import text

from dynident_client import Client
from dynident_service.settings import Settings
from dynident_service.storage.database import Database, migrate
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.repository_values import NewJob
from dynident_service.storage_and_engine import Services

HERE = Path(__file__).parent


@pytest.fixture(scope="session", autouse=True)
def _jobs_of_the_tests_can_be_imported_by_child_processes() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(filter(None, [str(HERE), os.environ.get("PYTHONPATH", "")])))
        yield
    SCIENCE.close()


@pytest.fixture(scope="session")
def settings(tmp_path_factory: pytest.TempPathFactory) -> Settings:
    return Settings(data_dir=tmp_path_factory.mktemp("service"), workers=2, max_upload_bytes=3_000_000)


@pytest.fixture(scope="session")
def client(settings: Settings) -> Iterator[TestClient]:
    with TestClient(app_of(settings), "http://127.0.0.1", raise_server_exceptions=False) as client:
        yield client


@pytest.fixture
def services(client: TestClient) -> Services:
    found = client.app.state.services  # type: ignore[attr-defined]
    assert isinstance(found, Services)
    return found


@pytest.fixture
def ledger(tmp_path: Path) -> Iterator[JobQueue]:
    """A ledger that no engine works on."""
    database = Database(f"sqlite:///{tmp_path / 'ledger.sqlite3'}")
    migrate(database)
    yield JobQueue(database, max_attempts=2)
    database.close()


@pytest.fixture(params=["sqlite", "postgresql"])
def new_database(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Database]:
    """A database of each kind, without tables."""
    url = f"sqlite:///{tmp_path / 'new.sqlite3'}"
    if request.param == "postgresql":
        server, name = str(request.getfixturevalue("postgresql")), f"new_{uuid.uuid4().hex}"
        first = Database(server)
        with first.engine.execution_options(isolation_level="AUTOCOMMIT").connect() as connection:
            connection.execute(text(f"CREATE DATABASE {name}"))
        first.close()
        url = server.rpartition("/")[0] + f"/{name}"
    database = Database(url)
    yield database
    database.close()


@pytest.fixture
def start(services: Services) -> Callable[..., str]:
    """Starts a small job; gives its id."""

    def begin(function: str, **arguments: Any) -> str:
        job_id = services.job_queue.enqueue(NewJob("report", f"small_jobs:{function}", arguments))
        services.engine.wake()
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
    job = services.job_queue.get(job_id)
    return job if job.state in ("succeeded", "failed", "cancelled") else None


@pytest.fixture(scope="module")
def installation(pytestconfig: pytest.Config) -> str:
    """What the service is made of that `live` speaks to."""
    return str(pytestconfig.getoption("--installation"))


@pytest.fixture(scope="module")
def live(
    request: pytest.FixtureRequest, installation: str, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Client]:
    """A client of a service that listens on a port of its own."""
    folder = tmp_path_factory.mktemp("live")
    server = partial(request.getfixturevalue, "postgresql_server")
    with installed(installation, folder, server) as url, Client(url) as client:
        yield client


@pytest.fixture(scope="module")
def postgresql(postgresql_server: str) -> Iterator[str]:
    """The URL of an empty database for the tests of one module: what they leave there must not reach others."""
    with temporary_database(postgresql_server) as url:
        yield url


@pytest.fixture(scope="session")
def postgresql_server() -> Iterator[str]:
    if shutil.which("initdb") is None or shutil.which("postgres") is None:
        pytest.skip("PostgreSQL is not installed")
    # PostgreSQL refuses to run as root.
    other_user: dict[str, Any] = {"user": "postgres"} if os.geteuid() == 0 else {}
    folder = Path(tempfile.gettempdir()) / f"dynident-postgresql-{os.getpid()}"
    folder.mkdir()
    if other_user:
        shutil.chown(folder, **other_user)
    port = free_port()
    options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder, **other_user}
    subprocess.run(["initdb", "-D", folder / "data", "-A", "trust", "-U", "dynident"], check=True, **options)
    server = subprocess.Popen(
        ["postgres", "-D", folder / "data", "-p", str(port), "-k", folder, "-c", "listen_addresses=127.0.0.1"],
        **options,
    )
    url = f"postgresql+psycopg://dynident@127.0.0.1:{port}/postgres"
    try:
        wait_for(lambda: _answers(url))
        yield url
    finally:
        # The fast way to stop: the plain one would wait for connections that a pool still holds.
        server.send_signal(signal.SIGINT)
        server.wait(timeout=60)
        shutil.rmtree(folder)


def _answers(url: str) -> bool:
    database = Database(url)
    try:
        database.ping()
    except Exception:
        return False
    finally:
        database.close()
    return True
