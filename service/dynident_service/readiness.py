"""The checks of `/readyz`: database, objects, child process; how long each may take."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

import anyio
from anyio import to_thread
from fastapi import Request
from sqlalchemy import select
from starlette.types import Message

from dynident_service.interactive_compute import InteractiveCompute
from dynident_service.jobs.confinement import ComputationLimits
from dynident_service.problems import ProblemError
from dynident_service.storage.database import Database
from dynident_service.storage.database_tables import ResourceRow
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
            "dynident_service.jobs.child_messages:confirm_readiness",
            bool,
            {},
            ComputationLimits(GIVEN_UP),
        )


async def _wait_forever() -> Message:
    """Stand in for a client that never leaves."""
    await anyio.sleep_forever()
    return {"type": "http.disconnect"}
