"""The engine: claims queued jobs while slots are free and starts them; how often it looks.

Jobs run in child processes of this process, each supervised by a thread, or of the workers of a Dask cluster whose
address is a setting. A local Dask cluster for the same purpose took more of the interpreter that answers requests than
accepting jobs did.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

from dynident_service.jobs.child_pool import ChildPool, ForkServer
from dynident_service.jobs.confinement import Confinement
from dynident_service.jobs.job_supervisor import supervise_job
from dynident_service.jobs.task_input_output import JobEnvironment
from dynident_service.science_preload import load_science
from dynident_service.settings import Settings
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim
from dynident_service.tracing import set_log_context

if TYPE_CHECKING:
    from dynident_service.jobs.dask_cluster import DaskExecutor

supervisor_log = logging.getLogger("dynident.supervisor")


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
            supervisor_log.exception("job %s attempt %d is left to its lease", claim.job_id, claim.attempt)
        finally:
            ended()

    def __exit__(self, *_: object) -> None:
        self._pool.close()


IDLE = 0.5
"""Seconds between looks into the queue while nobody reports new jobs."""
FULL = 2.0
"""Seconds between looks while all slots are taken, when only expired leases can be found. A look may open a transaction
that writes, for which those who submit jobs would wait.
"""
FIRST_PAUSE, LONGEST_PAUSE = 1.0, 15.0
"""Seconds between attempts to connect: the first pause, and the longest."""
STEADY = 60.0
"""Seconds after which a connection counts as good; if it breaks later, the first pause is short again."""
log = logging.getLogger("dynident.engine")

EngineState = Literal["starting", "ready", "without workers", "failed", "stopped"]


class Engine:
    """Thread that hands out jobs, from `start` to `close`. `news` is called when a job has begun or ended here."""

    def __init__(
        self, settings: Settings, job_queue: JobQueue, fork_server: ForkServer, news: Callable[[], None] = lambda: None
    ) -> None:
        self._settings = settings
        self._fork_server = fork_server
        self._job_queue = job_queue
        self._news = news
        """Called when a job has begun or ended here, for those who follow it."""
        self._place = JobEnvironment(
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
        """Ids of the jobs that were handed out by this process and have not come back, by job and attempt."""
        self._thread = threading.Thread(target=self._run, name="dynident-engine", daemon=True)
        self.state: EngineState = "starting"
        self.trouble = ""

    def start(self) -> None:
        """Start the thread; requests are answered and jobs accepted before workers are ready."""
        self._thread.start()

    def wake(self) -> None:
        """Report that there is a new job."""
        self._wake.set()

    def drain(self) -> None:
        """Claim no further jobs; those under way continue until `close`."""
        self._draining.set()

    @property
    def is_busy(self) -> bool:
        """Whether jobs are under way that `close` would stop."""
        return self._handing_out or bool(self._under_way)

    @property
    def condition(self) -> str:
        """State in a few words: `ready`, or why it is not."""
        if self._draining.is_set():
            return "draining"
        return f"failed: {self.trouble}" if self.state == "failed" else self.state

    def close(self, timeout: float = 20.0) -> None:
        """Stop the thread. Jobs on this machine return to the queue, those on a cluster continue."""
        self._stop.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout)

    def _run(self) -> None:
        # Import the science in the background, so that the first request that needs it does not wait.
        threading.Thread(target=load_science, name="dynident-warm-up", daemon=True).start()
        pause = FIRST_PAUSE
        while not self._stop.is_set():
            began = time.monotonic()
            try:
                self._serve_executor()
            except Exception as error:
                # A scheduler that is away, or was restarted; or a machine that starts no process just now.
                log.exception("the job engine lost its executor and starts again")
                self.trouble, self.state = f"{type(error).__name__}: {error}"[:300], "failed"
                if time.monotonic() - began > STEADY:
                    pause = FIRST_PAUSE
                self._stop.wait(pause)
                # Pauses double, so that a scheduler that stays away is not asked all the time.
                pause = min(2 * pause, LONGEST_PAUSE)
        self.state = "stopped"

    def _serve_executor(self) -> None:
        with self._create_executor() as workers:
            log.info("jobs run on %s, %d at a time", workers.address, workers.count_slots())
            while not self._stop.is_set():
                slots = workers.count_slots()
                self.trouble, self.state = "", "ready" if slots else "without workers"
                self._wake.wait(IDLE)
                self._wake.clear()
                if not self._stop.is_set():
                    self._distribute(workers, slots)

    def _create_executor(self) -> LocalExecutor | DaskExecutor:
        address = self._settings.dask_scheduler
        if not address:
            confinement = Confinement(self._settings.job_memory, self._settings.processes_dir)
            return LocalExecutor(self._settings.workers, self._fork_server, self._place, self._job_queue, confinement)
        from dynident_service.jobs.dask_cluster import DaskExecutor

        return DaskExecutor(address, self._place)

    def _distribute(self, workers: LocalExecutor | DaskExecutor, slots: int) -> None:
        claims: list[Claim] = []
        self._handing_out = True  # set before looking, so that a drain that begins now waits
        try:
            if slots > 0 and not self._draining.is_set() and self._is_look_due(slots):
                claims = self._job_queue.claim(slots, self._list_own_jobs())
            for claim in claims:
                self._hand_out(workers, claim)
            if claims:
                self._news()
        except Exception:
            # A database or a scheduler that is away for a moment: leases run out and the jobs are taken again.
            log.exception("could not hand out %d jobs", len(claims))
        finally:
            self._handing_out = False

    def _is_look_due(self, slots: int) -> bool:
        """Return whether to look into the queue now: a slot is free, or the last look was some time ago."""
        moment = time.monotonic()
        if len(self._under_way) >= slots and moment - self._looked < FULL:
            return False
        self._looked = moment
        return True

    def _list_own_jobs(self) -> list[str] | None:
        """Return the jobs that occupy slots of this process; None with a cluster, which several services may share.

        Jobs of another service that was killed occupy no slots here, though their leases have not expired.
        """
        return None if self._settings.dask_scheduler else list(self._under_way.values())

    def _hand_out(self, workers: LocalExecutor | DaskExecutor, claim: Claim) -> None:
        key = f"{claim.job_id}-{claim.attempt}"

        def on_end() -> None:
            self._under_way.pop(key, None)
            self._wake.set()
            self._news()

        if not self._settings.dask_scheduler:  # a cluster elsewhere goes on by itself
            self._under_way[key] = claim.job_id
        workers.submit(claim, on_end)
