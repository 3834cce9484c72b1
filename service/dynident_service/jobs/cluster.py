"""The Dask cluster that jobs run on: one in this process, or one elsewhere by its address."""

from __future__ import annotations

import logging
import time
from types import TracebackType
from typing import Any

from distributed import Client, LocalCluster

from dynident_service.jobs.supervisor import PLUGIN, Children
from dynident_service.jobs.work import Place
from dynident_service.settings import Settings

LOOK = 2.0
"""How often, in seconds, a cluster elsewhere is asked for its workers."""


class ClusterAway(Exception):
    """The scheduler does not answer, or is another one than before: connect anew."""


class Cluster:
    """A connection to a cluster whose workers have child processes ready."""

    def __init__(self, settings: Settings, place: Place) -> None:
        self._settings = settings
        self._place = place
        self._local: Any = None
        self._looked = 0.0
        self._slots = 0

    def __enter__(self) -> Cluster:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        if self._settings.dask_scheduler:
            self.address = self._settings.dask_scheduler
            self.client = Client(self.address, timeout="30s", set_as_default=False)
            try:
                self.client.get_versions(check=True)
                self.client.register_plugin(Children(self._place), name=PLUGIN)
                self._scheduler = self._identity()
            except BaseException:
                self.client.close(timeout=2)
                raise
        else:
            # Port 0: the scheduler would otherwise take the well-known port of the dashboard.
            self._local = LocalCluster(
                n_workers=1,
                threads_per_worker=self._settings.workers,
                processes=False,
                dashboard_address="127.0.0.1:0",
                worker_dashboard_address="127.0.0.1:0",
            )
            self.client = Client(self._local, set_as_default=False)
            self.client.register_plugin(Children(self._place), name=PLUGIN)
            self.address = "a local cluster"
        return self

    def slots(self) -> int:
        """How many jobs may run at a time: one for each thread of each worker that is there now.

        Raises ClusterAway where the connection has to be made anew. What is registered with a scheduler dies with it,
        so one that was restarted counts as away, too.
        """
        if self._local is not None:
            return self._settings.workers
        if time.monotonic() - self._looked >= LOOK:
            if self.client.status != "running" or self._identity() != self._scheduler:
                raise ClusterAway(f"the scheduler at {self.address} was restarted or does not answer")
            self._slots = sum(self.client.nthreads().values())
            self._looked = time.monotonic()
        return self._slots

    def _identity(self) -> str:
        scheduler: Any = self.client.scheduler
        return str(self.client.sync(scheduler.identity)["id"])

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._local is not None:
            self.client.unregister_worker_plugin(PLUGIN)
        self.client.close(timeout=5)
        if self._local is not None:
            self._local.close()
