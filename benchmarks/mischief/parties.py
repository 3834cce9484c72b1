"""Those who answer and do the jobs of one database: two services, or a service with a Dask cluster."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import psutil
from service_beside import free_port, wait_until_it_answers

from mischief.processes import Caretaker, Kept

JOBS = Path(__file__).resolve().parents[2] / "tests" / "service"
"""Where the small jobs of the tests are."""
SURVIVES = 10.0
"""Seconds that a process may outlive those who began it."""


@dataclass(frozen=True)
class Party:
    """Processes, each of which is started again when it has ended."""

    api: Kept
    port: int
    """On which `api` answers the clients."""
    workers: Sequence[Kept]
    """Those that clients do not know, and that do jobs."""
    scheduler: Kept | None = None

    @property
    def everybody(self) -> list[Kept]:
        """All of them, those first without whom the others cannot begin."""
        return [*filter(None, [self.scheduler]), *self.workers, self.api]

    @property
    def with_computations(self) -> list[Kept]:
        """Those that have processes which compute."""
        return [*self.workers, *([] if self.scheduler else [self.api])]


@contextmanager
def two_services(folder: Path, url: str) -> Iterator[Party]:
    """A service that clients know, and one that only works."""
    port, other = free_port(), free_port()
    api = _service("api", folder, url, port)
    wait_until_it_answers(port)
    worker = _service("worker", folder, url, other)
    with _kept(Party(api, port, [worker])) as party:
        wait_until_it_answers(other)
        yield party


@contextmanager
def on_a_cluster(folder: Path, url: str) -> Iterator[Party]:
    """A service whose jobs two Dask workers do, two at a time each: what `docker/compose.yaml` starts."""
    port, entrance = free_port(), free_port()
    address = f"tcp://127.0.0.1:{entrance}"
    scheduler = _of_dask("scheduler", folder, "dask_scheduler", "--host", "127.0.0.1", "--port", str(entrance))
    given = ("dask_worker", address, "--nthreads", "2", "--no-nanny")
    workers = [_of_dask(f"worker {number}", folder, *given) for number in (1, 2)]
    api = _service("api", folder, url, port, DYNIDENT_DASK_SCHEDULER=address)
    with _kept(Party(api, port, workers, scheduler)) as party:
        wait_until_it_answers(port)
        yield party


def left_behind(folder: Path) -> list[str]:
    """Say which processes are there that were begun in a folder, some seconds after all of a party have ended.

    Not before: the children of a nursery that was killed go on working for whoever has their pipes.
    """
    until = time.monotonic() + SURVIVES
    while (found := list(_begun_in(folder))) and time.monotonic() < until:
        time.sleep(0.2)
    return found


def _begun_in(folder: Path) -> Iterator[str]:
    for process in psutil.process_iter():
        with suppress(psutil.Error):
            if Path(process.cwd()) == folder:
                yield f"{process.pid} {' '.join(process.cmdline())}"


@contextmanager
def _kept(party: Party) -> Iterator[Party]:
    caretaker = Caretaker(party.everybody)
    try:
        yield party
    finally:
        caretaker.leave()
        for one in party.everybody:
            one.end()


def _service(name: str, folder: Path, url: str, port: int, **more: str) -> Kept:
    settings = {
        "DYNIDENT_DATA_DIR": str(folder / "data"),
        "DYNIDENT_DATABASE_URL": url,
        "DYNIDENT_PORT": str(port),
        "DYNIDENT_WORKERS": "2",
    }
    return Kept(name, folder, [sys.executable, "-m", "dynident_service"], {**_shared(), **settings, **more})


def _of_dask(name: str, folder: Path, program: str, *arguments: str) -> Kept:
    command = [sys.executable, "-m", f"distributed.cli.{program}", *arguments, "--dashboard-address", "127.0.0.1:0"]
    return Kept(name, folder, command, {**_shared(), "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error"})


def _shared() -> dict[str, str]:
    paths = [str(JOBS), *filter(None, [os.environ.get("PYTHONPATH")])]
    told = {"DYNIDENT_LOG_LEVEL": "warning", "DYNIDENT_LOG_FORMAT": "json"}
    return {"PYTHONPATH": os.pathsep.join(paths), **told}
