"""Run short computations that a request waits for, in child processes.

Holds how many may wait (30), and when a child process counts as stuck.
"""

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

from dynident_service.fair_queue import SharedPlaces, SharedQueue, Ticket
from dynident_service.jobs.child_pool import ChildPool, ChildProcess, ForkServer, ProcessExit
from dynident_service.jobs.confinement import ComputationLimits, Confinement
from dynident_service.jobs.job_supervisor import measure_processor_time
from dynident_service.jobs.task_input_output import Answer, Call
from dynident_service.problems import ProblemError
from dynident_service.request_limits import find_request_party, mark_long

T = TypeVar("T")

MAX_WAITING = 30
"""Upper limit for requests that wait for a child process or have one, shared by key; further ones get 429."""
LOOK = 0.25
"""Seconds between looks whether the client is still there."""
STUCK_SECONDS = 4.0
"""Seconds of processor time without a heartbeat after which a process counts as stuck: a library loops over a damaged
file. No computation of ours holds the interpreter for a second.
"""


class InteractiveCompute:
    """Runs computations of requests in child processes, as many at a time as there are children.

    The children are shared by key, and one of several is reserved for short computations.
    """

    def __init__(self, size: int, fork_server: ForkServer, confinement: Confinement | None = None) -> None:
        self._pool = ChildPool(size, fork_server, confinement)
        self._waiting = SharedPlaces(MAX_WAITING)
        self._queue = SharedQueue(size)
        self._threads = anyio.CapacityLimiter(size)

    async def call(
        self,
        request: Request,
        function: str,
        gives: type[T],
        arguments: Mapping[str, object],
        limits: ComputationLimits | None = None,
        *,
        is_long: bool = False,
    ) -> T:
        """Call a function in a child process and return its value.

        If the client of the request leaves, the child process is killed. `is_long` says that the function reads a file.

        Raise a `ProblemError`: 429 if too many requests wait, 503 if it takes too long, 408 if the client left, or the
        problem of the function.
        """
        party = find_request_party(request.scope)
        if not self._waiting.may_take(party):
            detail = (
                f"{self._waiting.held[party]} of your requests are being computed or wait. There is room for "
                f"{MAX_WAITING} requests, and a part is reserved for other callers. Try again soon."
            )
            raise ProblemError(429, detail, title="Too busy")
        # From here on the request waits for a child: its place among those that compute here is free for another.
        mark_long(request.scope)
        over = threading.Event()
        answer: Answer | None = None
        ticket = Ticket(party, is_long)
        self._waiting.take(party)
        try:
            # In this order: a client that leaves while its request is in the queue frees its place there, too.
            async with _while_client_waits(request, over), self._queue.wait_for_turn(ticket):
                answer = await to_thread.run_sync(
                    self._compute,
                    Call(function, arguments, limits=limits or ComputationLimits()),
                    over,
                    limiter=self._threads,
                )
        finally:
            self._waiting.give_back(party)
        if answer is None:
            raise ProblemError(408, "The client left before its answer was ready.", title="Client left")
        if answer.problem is not None:
            raise ProblemError.from_problem(answer.problem)
        value: T = answer.value
        return value

    def close(self) -> None:
        """Kill the child processes."""
        self._pool.close()

    def _compute(self, call: Call, over: threading.Event) -> Answer | None:
        child = self._pool.take()
        until = time.monotonic() + call.limits.longest
        watch = _ProgressWatch(child)
        try:
            child.send(call)
            # Short waits: between two of them the client may leave, the time may be over, or the child may be stuck.
            while (answer := child.receive(0.1)) is None:
                # A computation cannot be interrupted from outside: its process is killed, and another one takes the
                # place.
                if over.is_set():
                    self._pool.replace(child)
                    return None
                if time.monotonic() > until:
                    detail = (
                        f"The computation takes longer than {call.limits.longest:.0f} s, the longest time that a "
                        "request may take."
                    )
                    raise ProblemError(503, detail, title="Took too long")
                if watch.is_stuck():
                    raise _make_unreadable_problem("blocked the program that reads it, without any progress")
        except EOFError as error:
            raise _make_death_problem(self._pool.replace(child), call.limits) from error
        except BaseException:
            self._pool.replace(child)
            raise
        assert isinstance(answer, Answer)
        # Only a child that answered is used again; all others are replaced by new ones.
        self._pool.put_back(child, answer)
        return answer


class _ProgressWatch:
    """Detects a child that uses its processor without sending heartbeats."""

    def __init__(self, child: ChildProcess) -> None:
        self._child = child
        self._heartbeats = -1
        self._since = 0.0
        self._used = 0.0

    def is_stuck(self) -> bool:
        """Return whether the child is stuck. Only processor time counts: on a busy machine a child may get none."""
        if self._child.pid is None:
            return False
        moment = time.monotonic()
        # Each heartbeat begins the measurement anew.
        if self._heartbeats != self._child.heartbeats:
            self._heartbeats, self._since, self._used = (
                self._child.heartbeats,
                moment,
                measure_processor_time(self._child.pid),
            )
            return False
        # The cheap condition comes first: processor time is read from the system only if the child may be stuck.
        return (
            moment - self._since > STUCK_SECONDS
            and measure_processor_time(self._child.pid) - self._used > STUCK_SECONDS
        )


def _make_death_problem(end: ProcessExit | None, limits: ComputationLimits) -> ProblemError:
    """Return the problem of a child that died."""
    # The kernel kills with SIGKILL when memory runs out, and with SIGXCPU at the limit of processor time.
    if end is None or end.code == -signal.SIGKILL:
        detail = "The process that computed this died, most probably because memory ran out; send less at a time."
        return ProblemError(503, detail, title="Process died")
    if end.code == -signal.SIGXCPU:
        seconds = f"{limits.processor_seconds or limits.longest:.0f} s"
        return _make_unreadable_problem(
            f"occupied the program that reads it for more than {seconds}, far longer than a file of its size needs"
        )
    return _make_unreadable_problem(f"crashed the process that reads it ({_describe_exit(end.code)})")


def _describe_exit(code: int) -> str:
    return f"by {signal.Signals(-code).name}" if code < 0 else f"with code {code}"


def _make_unreadable_problem(event: str) -> ProblemError:
    """Return the problem of input that could not be read; `event` continues the sentence "What was sent"."""
    detail = (
        f"The data that you sent {event}. If it is a file, it is probably damaged: write it again, and send files "
        "one by one to find the damaged one."
    )
    return ProblemError(422, detail, title="Unreadable")


@asynccontextmanager
async def _while_client_waits(request: Request, over: threading.Event) -> AsyncIterator[None]:
    """End the block quietly when the client has left, and set `over` for the threads in it."""

    async def watch() -> None:
        while not await request.is_disconnected():
            await anyio.sleep(LOOK)
        # The cancellation does not reach a thread: that one looks at `over`.
        over.set()
        group.cancel_scope.cancel()

    failure: BaseException | None = None
    async with anyio.create_task_group() as group:
        group.start_soon(watch)
        try:
            yield
        except Exception as error:  # raised below, outside of the group
            failure = error
        group.cancel_scope.cancel()
    if failure is not None:
        raise failure
