"""The Dask cluster that jobs run on: one in this process, or one elsewhere by its address."""

from __future__ import annotations

import logging
from types import TracebackType
from typing import Any

from distributed import Client, LocalCluster

from dynident_service.jobs.supervisor import PLUGIN, Children
from dynident_service.jobs.work import Place
from dynident_service.settings import Settings


class Cluster:
    """A connection to a cluster whose workers have child processes ready."""

    def __init__(self, settings: Settings, place: Place) -> None:
        self._settings = settings
        self._place = place
        self._local: Any = None

    def __enter__(self) -> Cluster:
        logging.getLogger("distributed").setLevel(logging.ERROR)
        children = Children(self._place)
        if self._settings.dask_scheduler:
            self.address = self._settings.dask_scheduler
            self.client = Client(self.address, timeout="30s", set_as_default=False)
            self.client.get_versions(check=True)
            self.client.register_plugin(children, name=PLUGIN)
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
            self.client.register_plugin(children, name=PLUGIN)
            self.address = "a local cluster"
        return self

    def slots(self) -> int:
        """How many jobs may run at a time: one for each thread of each worker that is there now."""
        if self._local is not None:
            return self._settings.workers
        return sum(self.client.nthreads().values())

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._local is not None:
            self.client.unregister_worker_plugin(PLUGIN)
        self.client.close()
        if self._local is not None:
            self._local.close()
