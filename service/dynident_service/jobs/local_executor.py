"""Execution of jobs on this machine: child processes, each supervised by a thread of this process.

A local Dask cluster for the same purpose took more of the interpreter that answers requests than accepting jobs did.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.fork_server import ForkServer
from dynident_service.jobs.pool import ChildPool
from dynident_service.jobs.supervisor import supervise_job
from dynident_service.jobs.task import JobEnvironment
from dynident_service.logs import set_log_context
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim

log = logging.getLogger("dynident.supervisor")


class LocalExecutor:
    """Pool of warm child processes, as many as jobs may run at a time."""

    address = "this machine"

    def __init__(
        self, size: int, fork_server: ForkServer, place: JobEnvironment, job_queue: JobQueue, confinement: Confinement
    ) -> None:
        self._size = size
        self._fork_server = fork_server
        self._place = place
        self._job_queue = job_queue
        self._confinement = confinement

    def __enter__(self) -> LocalExecutor:
        self._pool = ChildPool(self._size, self._fork_server, self._confinement)
        return self

    def count_slots(self) -> int:
        """Return how many jobs may run at a time."""
        return self._size

    def submit(self, claim: Claim, ended: Callable[[], None]) -> None:
        """Do a job; `ended` is called in another thread when it comes back."""
        # A daemon thread: while it waits for a database that is away, it must not keep the process from ending.
        threading.Thread(
            target=self._run_job, args=(claim, ended), name=f"dynident-{claim.job_id}", daemon=True
        ).start()

    def _run_job(self, claim: Claim, ended: Callable[[], None]) -> None:
        try:
            with self._pool.mark_in_use(), set_log_context(claim.job_id, claim.request_id):
                supervise_job(claim, self._place, self._pool, self._job_queue)
        except Exception:
            log.exception("job %s attempt %d is left to its lease", claim.job_id, claim.attempt)
        finally:
            ended()

    def __exit__(self, *_: object) -> None:
        self._pool.close()
