"""The engine: takes jobs from the ledger as slots are free and gives them to those who do them.

Those are child processes of this one, or of the workers of a Dask cluster, whose address is a setting.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.crew import Crew
from dynident_service.jobs.nursery import Nursery
from dynident_service.jobs.work import Place
from dynident_service.science import load_science
from dynident_service.settings import Settings
from dynident_service.storage.ledger import Ledger
from dynident_service.storage.turns import Claim

if TYPE_CHECKING:
    from dynident_service.jobs.cluster import Cluster

IDLE = 0.5
"""How often, in seconds, the ledger is looked at when nobody has said that there is work."""
FULL = 2.0
"""The same, in seconds, while all slots are taken: only leases that ran out may be found, whoever says that there
is work. A look is a transaction that writes, which those who submit jobs would wait for."""
FIRST_PAUSE, LONGEST_PAUSE = 1.0, 15.0
"""Seconds between tries to connect."""
STEADY = 60.0
"""A connection that held for so many seconds was a good one: the next try comes soon."""
log = logging.getLogger("dynident.engine")

EngineState = Literal["starting", "ready", "without workers", "failed", "stopped"]


class Engine:
    """Runs in a thread of its own from `start` to `close`."""

    def __init__(
        self, settings: Settings, ledger: Ledger, nursery: Nursery, news: Callable[[], None] = lambda: None
    ) -> None:
        self._settings = settings
        self._nursery = nursery
        self._ledger = ledger
        self._news = news
        """Called when a job has begun or ended here, for those who follow it."""
        self._place = Place(
            settings.database,
            settings.objects,
            settings.cache_dir,
            settings.max_attempts,
            settings.job_deadline_seconds,
            settings.job_memory,
        )
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._draining = threading.Event()
        self._handing_out = False
        self._looked = -FULL
        self._under_way: dict[str, str] = {}
        """Ids of the jobs that were handed out to this process and have not come back, by job and attempt."""
        self._thread = threading.Thread(target=self._run, name="dynident-engine", daemon=True)
        self.state: EngineState = "starting"
        self.trouble = ""

    def start(self) -> None:
        """Start in the background: requests are answered, and jobs accepted, before workers are there."""
        self._thread.start()

    def nudge(self) -> None:
        """Say that there is a new job."""
        self._wake.set()

    def drain(self) -> None:
        """Take no job any more; those under way go on until `close`."""
        self._draining.set()

    @property
    def is_busy(self) -> bool:
        """Whether jobs are under way that would be stopped by `close`."""
        return self._handing_out or bool(self._under_way)

    @property
    def condition(self) -> str:
        """What it does, in a few words: `ready`, or why it is not."""
        if self._draining.is_set():
            return "draining"
        return f"failed: {self.trouble}" if self.state == "failed" else self.state

    def close(self, timeout: float = 20.0) -> None:
        """Stop; jobs of this machine go back to the queue, those of a cluster run on."""
        self._stop.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        # So that the first request that needs it does not wait for it.
        threading.Thread(target=load_science, name="dynident-warm-up", daemon=True).start()
        pause = FIRST_PAUSE
        while not self._stop.is_set():
            began = time.monotonic()
            try:
                self._work()
            except Exception as error:
                # A scheduler that is away, or was restarted; or a machine that starts no process just now.
                log.exception("the job engine lost those who do the jobs, and begins anew")
                self.trouble, self.state = f"{type(error).__name__}: {error}"[:300], "failed"
                if time.monotonic() - began > STEADY:
                    pause = FIRST_PAUSE
                self._stop.wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
        self.state = "stopped"

    def _work(self) -> None:
        with self._workers() as workers:
            log.info("jobs run on %s, %d at a time", workers.address, workers.slots())
            while not self._stop.is_set():
                slots = workers.slots()
                self.trouble, self.state = "", "ready" if slots else "without workers"
                self._wake.wait(IDLE)
                self._wake.clear()
                if not self._stop.is_set():
                    self._distribute(workers, slots)

    def _workers(self) -> Crew | Cluster:
        address = self._settings.dask_scheduler
        if not address:
            confinement = Confinement(self._settings.job_memory, self._settings.uploads_dir)
            return Crew(self._settings.workers, self._nursery, self._place, self._ledger, confinement)
        from dynident_service.jobs.cluster import Cluster

        return Cluster(address, self._place)

    def _distribute(self, workers: Crew | Cluster, slots: int) -> None:
        claims: list[Claim] = []
        self._handing_out = True  # said before it is looked, so that a drain that begins here waits
        try:
            if slots > 0 and not self._draining.is_set() and self._may_find(slots):
                claims = self._ledger.claim(slots, self._own())
            for claim in claims:
                self._hand_out(workers, claim)
            if claims:
                self._news()
        except Exception:
            # A database or a scheduler that is away for a moment: leases run out and the jobs are taken again.
            log.exception("could not hand out %d jobs", len(claims))
        finally:
            self._handing_out = False

    def _may_find(self, slots: int) -> bool:
        """Tell whether to look into the ledger now: a slot is free, or it was not looked for a while."""
        moment = time.monotonic()
        if len(self._under_way) >= slots and moment - self._looked < FULL:
            return False
        self._looked = moment
        return True

    def _own(self) -> list[str] | None:
        """The jobs that take slots of this process; not known of a cluster that several services may share.

        What a service held that was killed takes none of the slots of the others, until its lease runs out.
        """
        return None if self._settings.dask_scheduler else list(self._under_way.values())

    def _hand_out(self, workers: Crew | Cluster, claim: Claim) -> None:
        key = f"{claim.job_id}-{claim.attempt}"

        def ended() -> None:
            self._under_way.pop(key, None)
            self._wake.set()
            self._news()

        if not self._settings.dask_scheduler:  # a cluster elsewhere goes on by itself
            self._under_way[key] = claim.job_id
        workers.hand_out(claim, ended)
