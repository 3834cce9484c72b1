"""The checks of `/readyz`, and periodic maintenance: expired and abandoned data, checks of stored data.

Holds how long a check may take, and the intervals of the maintenance.
"""

from __future__ import annotations

import asyncio
import logging
import shutil
import threading
import time
from collections import Counter
from collections.abc import Awaitable, Callable
from contextlib import suppress
from datetime import timedelta
from pathlib import Path

import anyio
from anyio import to_thread
from fastapi import Request
from sqlalchemy import select
from starlette.types import Message

from dynident_service.interactive_compute import InteractiveCompute
from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.problems import ProblemError
from dynident_service.settings import Settings
from dynident_service.storage.database import Database
from dynident_service.storage.database_tables import ResourceRow
from dynident_service.storage.deletion_and_expiry import (
    IMPORT_LIFETIME,
    delete_expired,
    delete_unused_imports,
    sweep_objects,
)
from dynident_service.storage.integrity_check import REPAIRABLE, check_storage
from dynident_service.storage.object_store import ObjectStore

FRESH = 1.0
"""Seconds for which a result is reused, however often readiness is asked for."""
LONGEST = 1.0
"""Seconds within which the database and a child process must answer; users take a longer silence for a failure."""
LONGEST_OF_OBJECTS = 5.0
"""The same for the object store, which may be remote: an object is written and read in several requests."""
LONGEST_START = 60.0
"""Seconds that the first child process may take to import the science, on a busy machine."""
GIVEN_UP = 30.0
"""Seconds after which a child that does not answer is killed; it has kept the place of a user's request long enough."""


class ReadinessCheck:
    """Check of one part. A check under way is not started again, so a part that hangs occupies a single thread."""

    def __init__(self, ask: Callable[[], Awaitable[object]], longest: float, longest_start: float = 0.0) -> None:
        self._ask = ask
        self._longest = longest
        self._starts_until = time.monotonic() + longest_start
        self._task: asyncio.Task[str] | None = None
        self._began = -FRESH
        self._has_answered = False

    async def get_state(self) -> str:
        """Return `ok`, `starting`, or what is wrong, within the longest time."""
        moment = time.monotonic()
        if self._task is not None and self._task.done() and self._task.result() == "ok":
            self._has_answered = True
        if self._task is None or (self._task.done() and moment - self._began >= FRESH):
            # A part that hangs is asked once: more checks would take more threads, which requests need.
            self._began, self._task = moment, asyncio.create_task(self._answer())
        # Nobody waits for a part that is still starting: it does not keep the service from being ready.
        is_starting = not self._has_answered and moment < self._starts_until
        longest = 0.0 if is_starting else self._longest
        # `wait` leaves the task running at the timeout, unlike `wait_for`, which would cancel it.
        await asyncio.wait({self._task}, timeout=max(0.0, self._began + longest - time.monotonic()))
        state = self._task.result() if self._task.done() else f"failed: no answer within {self._longest:g} s"
        if state == "ok":
            self._has_answered = True
        elif is_starting:
            return "starting"
        return state

    async def _answer(self) -> str:
        try:
            await self._ask()
        except ProblemError as error:
            return f"failed: {error.problem.title}"
        except Exception as error:
            return f"failed: {type(error).__name__}"
        took = time.monotonic() - self._began
        return "ok" if took <= self._longest else f"failed: answered after {took:.1f} s"


class Readiness:
    """Checks of the database, the object store and a child process."""

    def __init__(self, database: Database, objects: ObjectStore, awaited: InteractiveCompute) -> None:
        self._database = database
        self._objects = objects
        self._awaited = awaited
        self._checks: dict[str, ReadinessCheck] = {}

    async def collect_states(self) -> dict[str, str]:
        """Return the state of each part."""
        if not self._checks:  # created here, in the event loop
            self._checks = {
                "database": ReadinessCheck(self._ask_database, LONGEST),
                "objects": ReadinessCheck(self._ask_objects, LONGEST_OF_OBJECTS),
                "computations": ReadinessCheck(self._ask_child, LONGEST, LONGEST_START),
            }
        states = await asyncio.gather(*(check.get_state() for check in self._checks.values()))
        return dict(zip(self._checks, states, strict=True))

    async def _ask_database(self) -> None:
        """Read a row with the threads and connections of requests."""
        await to_thread.run_sync(self._read_row)

    def _read_row(self) -> None:
        with self._database.read() as session:
            session.execute(select(ResourceRow.id).limit(1)).all()

    async def _ask_objects(self) -> None:
        await to_thread.run_sync(self._objects.ping, limiter=anyio.CapacityLimiter(1))

    async def _ask_child(self) -> None:
        await self._awaited.call(
            Request({"type": "http", "headers": []}, _wait_forever),
            "dynident_service.jobs.task_input_output:confirm_readiness",
            bool,
            {},
            ComputationLimits(GIVEN_UP),
        )


async def _wait_forever() -> Message:
    """Stand in for a client that never leaves."""
    await anyio.sleep_forever()
    return {"type": "http.disconnect"}


EVERY = 60.0
"""Seconds between rounds."""
ABANDONED = 24 * 3600.0
"""Seconds without a change after which an upload counts as abandoned."""
EXAMINED_EVERY = 600.0
"""Seconds between checks of all stored data."""
log = logging.getLogger("dynident.housekeeping")


class Housekeeping:
    """Maintenance thread, from `start` to `close`; every process of a service may have one."""

    def __init__(
        self, settings: Settings, database: Database, objects: ObjectStore, abandoned_before: float = 0.0
    ) -> None:
        self._settings = settings
        self._database = database
        self._objects = objects
        self._stop = threading.Event()
        self._abandoned_before = abandoned_before
        """Unfinished files that are older than this time are abandoned: no other service used the directory then."""
        self._examined: float | None = None
        self.condition = "ok"
        """Result of the last check of all stored data, in a few words."""
        self._thread = threading.Thread(target=self._run, name="dynident-housekeeping", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self, timeout: float = 10.0) -> None:
        """Stop after the current round."""
        self._stop.set()
        self._thread.join(timeout)

    def run_round(self) -> None:
        """Do one round of all that is due."""
        sweep_folder(self._settings.uploads_dir, max(time.time() - ABANDONED, self._abandoned_before))
        # Temporary files of running processes may be of any age, so only those from before this service are removed.
        sweep_folder(self._settings.processes_dir, self._abandoned_before)
        # Once, in the first round: later unfinished files are those of this service.
        if self._abandoned_before and self._examined is None:
            self._remove_what_was_being_written()
        delete_unused_imports(self._database, timedelta(seconds=IMPORT_LIFETIME))
        # Swept only after a grace period, since an upload may be about to own a file that looks abandoned.
        swept = sweep_objects(self._database, self._objects, timedelta(seconds=self._settings.deleted_kept_seconds))
        if swept:
            log.info("%d files without an owner were deleted", swept)
        delete_expired(self._database, timedelta(days=self._settings.history_kept_days))
        if self._examined is None or time.monotonic() - self._examined >= EXAMINED_EVERY:
            self.check_stored_data()

    def check_stored_data(self) -> None:
        """Check all stored data, without reading the contents of files."""
        counts = Counter(defect.trouble for defect in check_storage(self._database, self._objects, by_hash=False))
        wrong = {trouble: number for trouble, number in counts.items() if trouble not in REPAIRABLE}
        listed = ", ".join(f"{trouble}: {number}" for trouble, number in sorted(wrong.items()))
        self.condition = f"damaged ({listed}); `dynident doctor` shows details" if wrong else "ok"
        if wrong:
            log.error("the stored data are %s", self.condition)
        self._examined = time.monotonic()

    def _remove_what_was_being_written(self) -> None:
        """Remove unfinished files of a killed service from the object store and the cache."""
        for path in (*self._objects.list_leftovers(), *self._settings.cache_dir.glob("tmp*")):
            with suppress(FileNotFoundError):
                if path.stat().st_mtime < self._abandoned_before:
                    path.unlink()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.run_round()
            except Exception:
                # A database or a store that is away for a moment: the next round does what this one could not.
                log.exception("housekeeping failed")
            self._stop.wait(EVERY)


def sweep_folder(folder: Path, before: float) -> None:
    """Remove everything from a folder that has not changed since `before`."""
    for path in folder.glob("*"):
        with suppress(FileNotFoundError):
            if path.stat().st_mtime >= before:
                continue
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink()
