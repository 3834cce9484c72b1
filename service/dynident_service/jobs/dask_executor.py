"""Execution of jobs on a Dask cluster, given by its address."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from typing import Any

from distributed import Client, fire_and_forget

from dynident.version import __version__
from dynident_service.jobs.dask_worker import PLUGIN, ChildPoolPlugin, run_claim
from dynident_service.jobs.task import JobEnvironment
from dynident_service.storage.job_transitions import Claim

LOOK = 2.0
"""Seconds between queries for the cluster's workers."""


class ClusterUnreachable(Exception):
    """The scheduler does not answer, or is another one than before; the caller should connect again."""


class DaskExecutor:
    """Connection to a Dask cluster whose workers have child processes ready."""

    def __init__(self, address: str, place: JobEnvironment) -> None:
        self.address = address
        self._place = place
        self._looked = 0.0
        self._slots = 0

    def __enter__(self) -> DaskExecutor:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        self._client = Client(self.address, timeout="30s", set_as_default=False)
        try:
            self._client.get_versions(check=True)
            self._client.register_plugin(ChildPoolPlugin(self._place), name=PLUGIN)
            self._scheduler = self._get_scheduler_id()
        except BaseException:
            self._client.close(timeout=2)
            raise
        return self

    def count_slots(self) -> int:
        """Return how many jobs may run at a time: one for each thread of each worker that is there now.

        Raises
        ------
        ClusterAway
            If the connection has to be made again. A scheduler that was restarted counts as away too: it has lost the
            plugin that was registered with it.
        """
        if time.monotonic() - self._looked >= LOOK:
            if self._client.status != "running" or self._get_scheduler_id() != self._scheduler:
                raise ClusterUnreachable(f"the scheduler at {self.address} was restarted or does not answer")
            self._slots = sum(self._client.nthreads().values())
            self._looked = time.monotonic()
        return self._slots

    def submit(self, claim: Claim, ended: Callable[[], None]) -> None:
        """Have a worker do a job; `ended` is called in another thread when the job comes back."""
        # Dask runs a key once; the number of the attempt makes a repeated job a new task.
        key = f"{claim.job_id}-{claim.attempt}"
        future = self._client.submit(run_claim, claim, self._place, __version__, key=key, pure=False)
        future.add_done_callback(lambda _: ended())
        # Without it Dask cancels a task as soon as nobody holds its future.
        fire_and_forget(future)

    def _get_scheduler_id(self) -> str:
        scheduler: Any = self._client.scheduler
        return str(self._client.sync(scheduler.identity)["id"])

    def __exit__(self, *_: object) -> None:
        self._client.close(timeout=5)
