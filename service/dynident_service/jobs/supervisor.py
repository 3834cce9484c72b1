"""The Dask task of a job: gives it to a child process, keeps the lease, kills the child when it is to stop."""

from __future__ import annotations

import signal
import time
from typing import Any, cast

from distributed import WorkerPlugin, get_worker, secede

from dynident.version import __version__
from dynident_service.jobs.child import Order
from dynident_service.jobs.pool import Child, ChildPool
from dynident_service.jobs.work import Place
from dynident_service.storage.database import Database
from dynident_service.storage.ledger import Claim, Ledger

PLUGIN = "dynident-children"
LOOK = 0.1
"""How often, in seconds, the supervisor looks whether the job is to be cancelled."""
RENEW = 0.5


class Children(WorkerPlugin):
    """Gives every Dask worker its pool of warm child processes, and its connection to the ledger."""

    name = PLUGIN

    def __init__(self, place: Place) -> None:
        self.place = place
        self.version = __version__

    def setup(self, worker: Any) -> None:
        """Start the children, when the worker starts."""
        if self.version != __version__:
            raise RuntimeError(f"this worker has dynident {__version__}, the service {self.version}; install the same")
        self.pool = ChildPool(worker.state.nthreads)
        self.ledger = Ledger(Database(self.place.database_url), self.place.max_attempts)

    def teardown(self, worker: Any) -> None:
        """Kill the children, when the worker ends."""
        self.pool.close()

    def __getstate__(self) -> dict[str, Any]:
        """Cross to the worker without what belongs to one worker."""
        return {name: value for name, value in self.__dict__.items() if name not in ("pool", "ledger")}


def run_claim(claim: Claim) -> None:
    """Do a job; this is what Dask runs."""
    secede()  # waiting takes no thread of the worker
    plugin = cast(Children, get_worker().plugins[PLUGIN])
    with plugin.pool.in_use():
        supervise(claim, plugin.place, plugin.pool, plugin.ledger)


def supervise(claim: Claim, place: Place, pool: ChildPool, ledger: Ledger) -> None:
    """Have a child do the job; return when it has ended, was cancelled, or was lost to another worker."""
    if ledger.renew(claim) == "lost":
        return
    child = pool.take()
    try:
        child.send(Order(claim, place))
        receipt = _watch(claim, child, ledger)
    except (EOFError, BrokenPipeError):
        ended_with = pool.replace(child)
        if pool.closed:
            ledger.release(claim)
        else:
            ledger.died(claim, _describe(ended_with))
        return
    except BaseException:
        pool.replace(child)
        raise
    if receipt is None:
        pool.replace(child)
        ledger.stopped(claim)
    else:
        pool.put_back(child, receipt)


def _watch(claim: Claim, child: Child, ledger: Ledger) -> Any:
    renewed = time.monotonic()
    while (receipt := child.receive(LOOK)) is None:
        if time.monotonic() - renewed >= RENEW:
            standing = ledger.renew(claim)
            renewed = time.monotonic()
        else:
            standing = ledger.standing(claim)
        if standing != "held":
            # The child may just have ended the job by itself.
            return child.receive(0.0)
    return receipt


def _describe(ended_with: int | None) -> str:
    if ended_with is None:
        return "the process of the computation broke its connection"
    if ended_with < 0:
        return f"the process of the computation was killed by {signal.Signals(-ended_with).name}"
    return f"the process of the computation ended with code {ended_with}"
