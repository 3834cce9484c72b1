"""Run jobs on the workers of a Dask cluster; each has a pool of child processes."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any, cast

from distributed import Client, Worker, WorkerPlugin, fire_and_forget, get_worker, secede

from dynident.version import __version__
from dynident_service.jobs.child_pool import ChildPool, ForkServer
from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.job_supervisor import PATIENCE, supervise_job
from dynident_service.jobs.task_input_output import JobEnvironment
from dynident_service.storage.database import Database, retry_while_away
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim
from dynident_service.tracing import set_log_context

PLUGIN = "dynident-children"
_lock = threading.Lock()


class ChildPoolPlugin(WorkerPlugin):
    """Dask plugin that gives every worker a pool of warm child processes and a connection to the queue."""

    name = PLUGIN

    def __init__(self, place: JobEnvironment) -> None:
        self.place = place
        self.version = __version__

    def setup(self, worker: Worker) -> None:
        """Start the child processes when the worker starts."""
        if self.version != __version__:
            raise RuntimeError(
                f"this worker has dynident {__version__}, the service has {self.version}; install the same version"
            )
        self.fork_server = ForkServer()
        self.pool = ChildPool(worker.state.nthreads, self.fork_server, Confinement(self.place.memory))
        self.job_queue = JobQueue(Database(self.place.database_url), self.place.max_attempts)

    def teardown(self, worker: Worker) -> None:
        """Kill the child processes when the worker ends; their jobs are given back."""
        self.pool.close()
        self.fork_server.close()

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the attributes that belong to one worker, so that the plugin can be sent to others."""
        return {
            name: value for name, value in self.__dict__.items() if name not in ("fork_server", "pool", "job_queue")
        }


def run_claim(claim: Claim, place: JobEnvironment, version: str) -> None:
    """Do a job; Dask calls this on a worker."""
    secede()  # waiting takes no thread of the worker
    plugin = _get_plugin(get_worker(), place, version)
    with plugin.pool.mark_in_use(), set_log_context(claim.job_id, claim.request_id):
        # It may have come here late.
        if plugin.pool.closed or retry_while_away(lambda: plugin.job_queue.renew(claim), PATIENCE) != "lost":
            supervise_job(claim, place, plugin.pool, plugin.job_queue)


def _get_plugin(worker: Any, place: JobEnvironment, version: str) -> ChildPoolPlugin:
    """Return the plugin of a worker, and set it up if a worker that joined with a restarted scheduler lacks it."""
    with _lock:
        plugin = worker.plugins.get(PLUGIN)
        if plugin is None:
            plugin = ChildPoolPlugin(place)
            plugin.version = version
            plugin.setup(worker)
            worker.plugins[PLUGIN] = plugin
        return cast(ChildPoolPlugin, plugin)


WORKER_QUERY_INTERVAL = 2.0
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

        Raise `ClusterUnreachable` if the connection has to be made again. A scheduler that was restarted counts as away
        too: it has lost the plugin that was registered with it.
        """
        if time.monotonic() - self._looked >= WORKER_QUERY_INTERVAL:
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
