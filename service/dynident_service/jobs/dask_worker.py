"""Code that runs on the workers of a Dask cluster: a pool of child processes each, for jobs and for parts of jobs."""

from __future__ import annotations

import threading
from dataclasses import replace
from typing import Any, cast

from distributed import Worker, WorkerPlugin, get_worker, secede

from dynident.version import __version__
from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.nursery import Nursery
from dynident_service.jobs.part_supervisor import look_after
from dynident_service.jobs.parts import Part
from dynident_service.jobs.pool import ChildPool
from dynident_service.jobs.supervisor import PATIENCE, supervise
from dynident_service.jobs.work import Colleagues, Place
from dynident_service.logs import working_on
from dynident_service.storage.database import Database
from dynident_service.storage.ledger import Ledger
from dynident_service.storage.patience import patiently
from dynident_service.storage.turns import Claim

PLUGIN = "dynident-children"
_lock = threading.Lock()


class Children(WorkerPlugin):
    """Dask plugin that gives every worker a pool of warm child processes and a connection to the queue."""

    name = PLUGIN

    def __init__(self, place: Place) -> None:
        self.place = place
        self.version = __version__

    def setup(self, worker: Worker) -> None:
        """Start the child processes when the worker starts."""
        if self.version != __version__:
            raise RuntimeError(f"this worker has dynident {__version__}, the service {self.version}; install the same")
        self.nursery = Nursery()
        self.pool = ChildPool(worker.state.nthreads, self.nursery, Confinement(self.place.memory))
        self.ledger = Ledger(Database(self.place.database_url), self.place.max_attempts)

    def teardown(self, worker: Worker) -> None:
        """Kill the child processes when the worker ends; their jobs are given back."""
        self.pool.close()
        self.nursery.close()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the attributes that belong to one worker, so that the plugin can be sent to others."""
        return {name: value for name, value in self.__dict__.items() if name not in ("nursery", "pool", "ledger")}


def run_claim(claim: Claim, place: Place, version: str) -> None:
    """Do a job; Dask calls this on a worker."""
    secede()  # waiting takes no thread of the worker
    worker = get_worker()
    plugin = _children_of(worker, place, version)
    place = replace(place, colleagues=Colleagues(worker.scheduler.address, worker.address))
    with plugin.pool.in_use(), working_on(claim.job_id, claim.request_id):
        # It may have come here late.
        if plugin.pool.closed or patiently(lambda: plugin.ledger.renew(claim), PATIENCE) != "lost":
            supervise(claim, place, plugin.pool, plugin.ledger)


def run_part(part: Part, version: str) -> bytes | None:
    """Do a part of a job that runs on another worker; return None if this worker has enough to do.

    Jobs come first: a part neither waits for a slot nor keeps one from a job that arrives meanwhile.
    """
    secede()
    plugin = _children_of(get_worker(), part.place, version)
    with plugin.pool.in_use_if_spare() as spare, working_on(part.claim.job_id, part.claim.request_id):
        return look_after(part, plugin.pool, plugin.ledger) if spare else None


def _children_of(worker: Any, place: Place, version: str) -> Children:
    """Return the plugin of a worker, and set it up if a worker that joined with a restarted scheduler lacks it."""
    with _lock:
        plugin = worker.plugins.get(PLUGIN)
        if plugin is None:
            plugin = Children(place)
            plugin.version = version
            plugin.setup(worker)
            worker.plugins[PLUGIN] = plugin
        return cast(Children, plugin)
