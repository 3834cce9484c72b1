"""What several tests of the service use."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import uvicorn
from fastapi import FastAPI
from fork_servers import OfTests
from sqlalchemy import update

from dynident_service.app import create_app
from dynident_service.serve import build_server_config
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.database_tables import JOBS

TWO_JOINTS = {
    "joints": [
        {"name": "shoulder", "alpha": 0, "d": 0, "r": 0},
        {"name": "elbow", "alpha": 0, "d": 0.5, "r": 0},
    ]
}


SCIENCE = OfTests()
"""Loading the science takes longer than most tests: all services of a test process have their children from here."""


def app_of(settings: Settings) -> FastAPI:
    return create_app(settings, SCIENCE)


def wait_for(condition: Callable[[], Any], timeout: float = 30.0) -> Any:
    end, pause = time.monotonic() + timeout, 0.01
    while time.monotonic() < end:
        if found := condition():
            return found
        # Many conditions ask the service, which takes the processor from what is waited for.
        time.sleep(pause)
        pause = min(2 * pause, 0.1)
    raise AssertionError(f"not within {timeout} s")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def let_leases_run_out(database: Database) -> None:
    """Let the time go by, for who looks at the jobs that are held, after which one that nobody renews is another's."""
    with database.engine.begin() as connection:
        connection.execute(update(JOBS).where(JOBS.c.state == "running").values(lease_until=JOBS.c.created_at))


@contextmanager
def serving(settings: Settings, *, with_science_of_its_own: bool = False) -> Iterator[str]:
    """A service that listens on a port of its own; gives its address.

    `with_science_of_its_own`: its children see the environment as it is now, not as it was when others were started.
    """
    science = OfTests() if with_science_of_its_own else SCIENCE
    app = create_app(settings, science)
    server = uvicorn.Server(build_server_config(app, settings))
    thread = threading.Thread(target=server.run)
    thread.start()
    try:
        wait_for(lambda: server.started or not thread.is_alive())
        yield f"http://127.0.0.1:{server.servers[0].sockets[0].getsockname()[1]}"
    finally:
        server.should_exit = True
        thread.join()
        if with_science_of_its_own:
            science.close()
