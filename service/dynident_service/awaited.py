"""Computations that a request waits for: in a few processes of their own, and no longer than its client waits."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import AsyncIterator, Mapping
from contextlib import asynccontextmanager
from typing import TypeVar

import anyio
from anyio import to_thread
from fastapi import Request

from dynident_service.fair_shares import SharedPlaces, SharedQueue, Ticket
from dynident_service.jobs.calls import Answer, Call
from dynident_service.jobs.confinement import Confinement, Limits
from dynident_service.jobs.nursery import Exit, Nursery
from dynident_service.jobs.pool import Child, ChildPool
from dynident_service.jobs.vitals import processor_time
from dynident_service.limits import party_of_request, take_long
from dynident_service.problems import ProblemError

T = TypeVar("T")

MOST_WAITING = 30
"""Requests that may wait for a process or have one, shared by key; one more is told to come back."""
LOOK = 0.25
"""How often, in seconds, it is looked whether the client is still there."""
STUCK_SECONDS = 4.0
"""Processor time without a sign of life after which a process is stuck in a library that goes round in circles in a
damaged file. None of ours keeps the interpreter for a second."""


class Awaited:
    """Has children compute for requests, as many at a time as there are children.

    They are shared by key, and one of several is kept for short computations.
    """

    def __init__(self, size: int, nursery: Nursery, confinement: Confinement | None = None) -> None:
        self._pool = ChildPool(size, nursery, confinement)
        self._waiting = SharedPlaces(MOST_WAITING)
        self._queue = SharedQueue(size)
        self._threads = anyio.CapacityLimiter(size)

    async def call(
        self,
        request: Request,
        function: str,
        gives: type[T],
        arguments: Mapping[str, object],
        limits: Limits | None = None,
        *,
        is_long: bool = False,
    ) -> T:
        """Compute what a function gives, within limits; `is_long` says that it reads a file, which may take long.

        A problem 429 if too many wait, 503 if it takes too long, and whatever problem comes out.
        Where the client leaves, the process is killed.
        """
        party = party_of_request(request.scope)
        if not self._waiting.may_take(party):
            detail = (
                f"{self._waiting.held[party]} of your requests are computed or wait for it, of {MOST_WAITING} that "
                "may, of which some stay free for others; try again."
            )
            raise ProblemError(429, detail, title="Too busy")
        take_long(request.scope)
        over = threading.Event()
        found: Answer | None = None
        ticket = Ticket(party, is_long)
        self._waiting.take(party)
        try:
            async with _while_client_waits(request, over), self._queue.turn_of(ticket):
                found = await to_thread.run_sync(
                    self._compute, Call(function, arguments, limits=limits or Limits()), over, limiter=self._threads
                )
        finally:
            self._waiting.give_back(party)
        if found is None:
            raise ProblemError(408, "The client left before its answer was there.", title="Client left")
        if found.problem is not None:
            raise ProblemError.of(found.problem)
        value: T = found.value
        return value

    def close(self) -> None:
        """Kill the children."""
        self._pool.close()

    def _compute(self, call: Call, over: threading.Event) -> Answer | None:
        child = self._pool.take()
        until = time.monotonic() + call.limits.longest
        watch = _ProgressWatch(child)
        try:
            child.send(call)
            while (found := child.receive(0.1)) is None:
                if over.is_set():
                    self._pool.replace(child)
                    return None
                if time.monotonic() > until:
                    detail = f"This takes longer than {call.limits.longest:.0f} s, which is more than it may take."
                    raise ProblemError(503, detail, title="Took too long")
                if watch.is_stuck():
                    raise _unreadable("kept the program that read it busy without any progress")
        except EOFError as error:
            raise _died(self._pool.replace(child), call.limits) from error
        except BaseException:
            self._pool.replace(child)
            raise
        assert isinstance(found, Answer)
        self._pool.put_back(child, found)
        return found


class _ProgressWatch:
    """Tells whether a child uses its processor without giving a sign of life."""

    def __init__(self, child: Child) -> None:
        self._child = child
        self._heartbeats = -1
        self._since = 0.0
        self._used = 0.0

    def is_stuck(self) -> bool:
        """Look again; processor time counts, since one that has none, beside much other work, gives no sign either."""
        if self._child.pid is None:
            return False
        moment = time.monotonic()
        if self._heartbeats != self._child.heartbeats:
            self._heartbeats, self._since, self._used = self._child.heartbeats, moment, processor_time(self._child.pid)
            return False
        # The system is asked only where it could be so.
        return moment - self._since > STUCK_SECONDS and processor_time(self._child.pid) - self._used > STUCK_SECONDS


def _died(end: Exit | None, limits: Limits) -> ProblemError:
    """What is said of a process that ended by itself."""
    if end is None or end.code == -signal.SIGKILL:
        detail = "The process that computed this died, most probably for want of memory; send less at a time."
        return ProblemError(503, detail, title="Process died")
    if end.code == -signal.SIGXCPU:
        seconds = f"{limits.processor_seconds or limits.longest:.0f} s"
        return _unreadable(f"took the program that read it more than {seconds}, far more than a file of its size takes")
    return _unreadable(f"ended the process that read it ({_describe_exit(end.code)})")


def _describe_exit(code: int) -> str:
    return f"by {signal.Signals(-code).name}" if code < 0 else f"with code {code}"


def _unreadable(what: str) -> ProblemError:
    """Say what became of reading something; `what` goes on after "What was sent"."""
    detail = (
        f"What was sent {what}. If it is a file, it is most probably damaged: have it written anew, and send files one "
        "by one to find which."
    )
    return ProblemError(422, detail, title="Unreadable")


@asynccontextmanager
async def _while_client_waits(request: Request, over: threading.Event) -> AsyncIterator[None]:
    """End the block, quietly, when the client has left; sets `over` for the threads in it."""

    async def watch() -> None:
        while not await request.is_disconnected():
            await anyio.sleep(LOOK)
        over.set()
        group.cancel_scope.cancel()

    failure: BaseException | None = None
    async with anyio.create_task_group() as group:
        group.start_soon(watch)
        try:
            yield
        except Exception as error:  # to be raised as it is, not as one of a group
            failure = error
        group.cancel_scope.cancel()
    if failure is not None:
        raise failure
