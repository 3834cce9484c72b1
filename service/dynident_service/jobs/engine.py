"""The engine: takes jobs from the ledger as slots are free and gives them to Dask.

A local Dask cluster lives in this process (its worker only supervises; the work is in child processes); the address of
a real cluster is a setting.
"""

from __future__ import annotations

import importlib
import logging
import threading
from typing import TYPE_CHECKING, Literal

from dynident_service.jobs.work import Place
from dynident_service.settings import Settings
from dynident_service.storage.ledger import Claim, Ledger

if TYPE_CHECKING:
    from distributed import Client

IDLE = 0.5
"""How often, in seconds, the ledger is looked at when nobody has said that there is work."""
log = logging.getLogger("dynident.engine")

EngineState = Literal["starting", "ready", "failed", "stopped"]


class Engine:
    """Runs in a thread of its own from `start` to `close`."""

    def __init__(self, settings: Settings, ledger: Ledger) -> None:
        self._settings = settings
        self._ledger = ledger
        self._place = Place(settings.database, settings.objects, settings.cache_dir, settings.max_attempts)
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="dynident-engine", daemon=True)
        self.state: EngineState = "starting"
        self.trouble = ""

    def start(self) -> None:
        """Start in the background: requests are answered, and jobs accepted, before workers are there."""
        self._thread.start()

    def nudge(self) -> None:
        """Say that there is a new job."""
        self._wake.set()

    def close(self, timeout: float = 20.0) -> None:
        """Stop; jobs of the local cluster go back to the queue, those of a real cluster run on."""
        self._stop.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        try:
            from dynident_service.jobs.cluster import Cluster

            warm = threading.Thread(target=_load_science, name="dynident-warm-up", daemon=True)
            with Cluster(self._settings, self._place) as cluster:
                self.state = "ready"
                warm.start()
                log.info("jobs run on %s, %d at a time", cluster.address, cluster.slots())
                while not self._stop.is_set():
                    self._wake.wait(IDLE)
                    self._wake.clear()
                    if not self._stop.is_set():
                        self._distribute(cluster.client, cluster.slots())
            self.state = "stopped"
        except Exception as error:
            log.exception("the job engine failed")
            self.state, self.trouble = "failed", f"{type(error).__name__}: {error}"

    def _distribute(self, client: Client, slots: int) -> None:
        from distributed import fire_and_forget

        from dynident_service.jobs.supervisor import run_claim

        claims: list[Claim] = []
        try:
            claims = self._ledger.claim(slots) if slots > 0 else []
            for claim in claims:
                key = f"{claim.job_id}-{claim.attempt}"
                future = client.submit(run_claim, claim, key=key, pure=False)
                future.add_done_callback(lambda _: self._wake.set())
                fire_and_forget(future)
        except Exception:
            # A database or a scheduler that is away for a moment: leases run out and the jobs are taken again.
            log.exception("could not hand out %d jobs", len(claims))


def _load_science() -> None:
    """Load what requests will need, so that the first one does not wait for it."""
    importlib.import_module("dynident_service.work")
