"""What runs on the workers of a Dask cluster: a pool of child processes each, and tasks: jobs, and parts of others."""

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
    """Gives every Dask worker its pool of warm child processes, and its connection to the ledger."""

    name = PLUGIN

    def __init__(self, place: Place) -> None:
        self.place = place
        self.version = __version__

    def setup(self, worker: Worker) -> None:
        """Start the children, when the worker starts."""
        if self.version != __version__:
            raise RuntimeError(f"this worker has dynident {__version__}, the service {self.version}; install the same")
        self.nursery = Nursery()
        self.pool = ChildPool(worker.state.nthreads, self.nursery, Confinement(self.place.memory))
        self.ledger = Ledger(Database(self.place.database_url), self.place.max_attempts)

    def teardown(self, worker: Worker) -> None:
        """Kill the children, when the worker ends; what they did is given back."""
        self.pool.close()
        self.nursery.close()

    def __getstate__(self) -> dict[str, Any]:
        """Cross to the worker without what belongs to one worker."""
        return {name: value for name, value in self.__dict__.items() if name not in ("nursery", "pool", "ledger")}


def run_claim(claim: Claim, place: Place, version: str) -> None:
    """Do a job; this is what Dask runs."""
    secede()  # waiting takes no thread of the worker
    worker = get_worker()
    plugin = _children_of(worker, place, version)
    place = replace(place, colleagues=Colleagues(worker.scheduler.address, worker.address))
    with plugin.pool.in_use(), working_on(claim.job_id, claim.request_id):
        # It may have come here late.
        if plugin.pool.closed or patiently(lambda: plugin.ledger.renew(claim), PATIENCE) != "lost":
            supervise(claim, place, plugin.pool, plugin.ledger)


def run_part(part: Part, version: str) -> bytes | None:
    """Do a part of a job that another worker does; None where there is enough to do here already.

    Jobs come first: no part waits here for a slot, and none takes one from a job that comes meanwhile.
    """
    secede()
    plugin = _children_of(get_worker(), part.place, version)
    with plugin.pool.in_use_if_spare() as spare, working_on(part.claim.job_id, part.claim.request_id):
        return look_after(part, plugin.pool, plugin.ledger) if spare else None


def _children_of(worker: Any, place: Place, version: str) -> Children:
    """The children of a worker; one that came with a restarted scheduler may not have any yet."""
    with _lock:
        found = worker.plugins.get(PLUGIN)
        if found is None:
            found = Children(place)
            found.version = version
            found.setup(worker)
            worker.plugins[PLUGIN] = found
        return cast(Children, found)
