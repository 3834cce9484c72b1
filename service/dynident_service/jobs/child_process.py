"""The main loop of a child process: runs jobs and calls, reports progress and heartbeats.

A process of its own can be stopped even inside a solver: its process group is killed.
"""

from __future__ import annotations

import fcntl
import importlib
import logging
import os
import resource
import signal
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any, cast

from sqlalchemy.orm import Session

from dynident.errors import Cancelled, DynidentError
from dynident_service import tracing
from dynident_service.jobs.confinement import Confinement, is_out_of_memory
from dynident_service.jobs.task_input_output import (
    PATIENCE,
    Answer,
    Call,
    End,
    Heartbeat,
    Hello,
    JobEnvironment,
    JobFunction,
    JobOrder,
    ObjectCache,
    Outcome,
    Receipt,
    Task,
    answer_call,
    make_memory_problem,
)
from dynident_service.problems import Problem, ProblemError, make_problem, to_problem
from dynident_service.settings import LogSettings
from dynident_service.storage.data_directory import is_disk_full
from dynident_service.storage.database import INFRASTRUCTURE_ERRORS, Database, describe_error, retry_while_away
from dynident_service.storage.database_tables import ResourceRow
from dynident_service.storage.job_queue import CheckpointStore, JobCheckpoints, JobQueue, LostClaim
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.resource_repository import Resources
from dynident_service.storage.resource_rows import insert_dependencies, insert_objects, insert_resources
from dynident_service.tracing import set_log_context

PROGRESS_INTERVAL = 0.1
"""Shortest time in seconds between two reports of progress."""
SMALLEST_STEP = 0.005
"""Smallest change of the fraction that is reported."""
HEARTBEAT = 1.0
"""Seconds between heartbeats."""
SWITCH = 0.05
"""Seconds between attempts to take the interpreter from a solver that holds it; each attempt costs a little."""
STANDS_BACK = 5
"""Niceness added for a process that a request waits for, relative to the process that answers; a job gets it twice."""
REST = 1.0
"""Seconds before a job is given back after a failure of the infrastructure, so that it does not return at once."""
log = logging.getLogger("dynident.job")


class JobRunner:
    """Database, object store and memory of a child process, opened once for all its jobs."""

    def __init__(self, place: JobEnvironment) -> None:
        self.place = place
        self.database = Database(place.database_url)
        self.job_queue = JobQueue(self.database, place.max_attempts)
        self.objects = ObjectStore(place.object_store_url, place.cache_dir)
        self.resources = Resources(self.database, self.objects)
        self.memory = ObjectCache()

    def run(self, claim: Claim) -> None:
        """Do a job and write its end into the queue.

        Raise one of `INFRASTRUCTURE_ERRORS` if the end cannot be written.
        """
        with tracing.trace_task(f"job {claim.function}", claim.trace, **{"dynident.attempt": claim.attempt}):
            end = self._attempt(claim)
            retry_while_away(lambda: end(self.job_queue), PATIENCE)

    def _attempt(self, claim: Claim) -> End:
        """Do a job, and return the action that writes its end into the queue."""
        try:
            outcome = self._call(claim)
            retry_while_away(lambda: self._record_success(claim, outcome), PATIENCE)
        except INFRASTRUCTURE_ERRORS as error:
            if is_disk_full(error):
                return _make_failure(claim, _make_disk_full_problem())
            raise
        except (LostClaim, Cancelled):
            log.info("job %s attempt %d: no longer wanted", claim.job_id, claim.attempt)
            return lambda job_queue: job_queue.record_cancellation(claim)
        except (DynidentError, ProblemError) as error:
            return _make_failure(claim, to_problem(error))
        except Exception as error:
            if is_out_of_memory(error):
                return _make_failure(claim, make_memory_problem(self.place.memory))
            if is_disk_full(error):
                return _make_failure(claim, _make_disk_full_problem())
            log.exception("job %s attempt %d failed unexpectedly", claim.job_id, claim.attempt)
            detail = f"The computation failed unexpectedly; the service's log says where, under job {claim.job_id}."
            return _make_failure(claim, make_problem(500, detail))
        return lambda job_queue: None

    def _record_success(self, claim: Claim, outcome: Outcome) -> None:
        # This may be repeated after a commit whose confirmation was lost. It then finds the job ended and raises
        # LostClaim, which does no harm.
        self.job_queue.record_success(claim, lambda session: _store_outcome(session, self.objects, claim, outcome))

    def _call(self, claim: Claim) -> Outcome:
        module, _, name = claim.function.partition(":")
        function = cast(JobFunction, getattr(importlib.import_module(module), name))
        subject = None
        if claim.resource_id is not None:
            # The resource may have been deleted since the job was claimed; nobody waits for the job then.
            subject = self.resources.find(claim.resource_id)
            if subject is None:
                raise LostClaim(claim.job_id)
        reporter, checkpoints = Reporter(self.job_queue, claim), JobCheckpoints(CheckpointStore(self.database), claim)
        task = Task(subject, claim.arguments, self.resources, self.objects, self.memory, reporter, checkpoints)
        return function(task)


class Reporter:
    """Writes progress into the queue, at a limited rate."""

    def __init__(self, job_queue: JobQueue, claim: Claim) -> None:
        self._job_queue = job_queue
        self._claim = claim
        self._last_time = time.monotonic()
        self._last_fraction = 0.0
        self._last_message = ""

    def __call__(self, fraction: float, message: str) -> None:
        """Report progress; raise LostClaim if nobody waits for the job any more."""
        moved = fraction - self._last_fraction >= SMALLEST_STEP or message != self._last_message
        if not moved or time.monotonic() - self._last_time < PROGRESS_INTERVAL:
            return
        fraction = min(1.0, max(0.0, float(fraction)))
        try:
            self._job_queue.record_progress(self._claim, fraction, message)
        except INFRASTRUCTURE_ERRORS as error:  # the work goes on; the next report may get through
            log.warning("job %s: progress could not be written: %s", self._claim.job_id, describe_error(error))
        self._last_time, self._last_fraction, self._last_message = time.monotonic(), fraction, message


def _make_disk_full_problem() -> Problem:
    detail = "A disk is full, so the result could not be stored; ask the operator of the service to free space."
    return make_problem(507, detail, title="Disk full")


def _make_failure(claim: Claim, problem: Problem) -> End:
    return lambda job_queue: job_queue.record_failure(claim, problem)


def _store_outcome(session: Session, objects: ObjectStore, claim: Claim, outcome: Outcome) -> None:
    result: dict[str, Any] = dict(outcome.result)
    row = None if claim.resource_id is None else session.get_one(ResourceRow, claim.resource_id)
    if outcome.creates is not None:
        (created,) = insert_resources(session, objects, [outcome.creates], None if row is None else row.owner)
        result[f"{created.kind}_id"] = created.id
        if claim.resource_id is not None:
            insert_dependencies(session, [(claim.resource_id, created.id, "result")])
    if claim.resource_id is not None and row is not None:
        row.result = result
        if outcome.request:
            # Another mapping: changes within the stored one would not be noticed.
            row.request = {**row.request, **outcome.request}
        insert_objects(session, objects, [(claim.resource_id, owned) for owned in outcome.objects])


class SupervisorPipe:
    """Pipe to the supervisor, with a thread that sends heartbeats while a job is done."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._busy = threading.Event()
        threading.Thread(target=self._beat, daemon=True).start()

    def send(self, message: Hello | Heartbeat | Receipt | Answer) -> None:
        """Send a message; several threads may call it."""
        with self._lock:
            self._connection.send(message)

    @contextmanager
    def send_heartbeats(self) -> Iterator[None]:
        """Send heartbeats in this context."""
        self._busy.set()
        try:
            yield
        finally:
            self._busy.clear()

    def _beat(self) -> None:
        with suppress(OSError):  # the other end is closed
            while self._busy.wait():
                self.send(Heartbeat())
                time.sleep(HEARTBEAT)


def serve_jobs(jobs: int, lifeline: int) -> None:
    """Do the jobs and calls that arrive on a pipe, until its other end is closed.

    The first message on `jobs` is the confinement; the other end of `lifeline` is closed when the supervisor ends.
    """
    connection = Connection(jobs)
    _lower_priority()
    try:
        confinement: Confinement = connection.recv()
    except (EOFError, OSError):
        return
    # Confine before any other thread starts: Landlock restricts the calling thread and those that it starts later.
    confinement.apply((jobs, lifeline))
    _die_with_parent(lifeline)
    sys.setswitchinterval(SWITCH)
    line = SupervisorPipe(connection)
    line.send(Hello(os.getpid()))
    if LogSettings().traces:
        _begin_tracing()
    workshop: JobRunner | None = None
    behind = False
    while True:
        try:
            order = connection.recv()
        except (EOFError, OSError):
            return
        # The priority can only be lowered. A child that has done a job is therefore slower than a request needs, but
        # jobs and requests have pools of their own.
        if not behind and isinstance(order, JobOrder):
            _lower_priority()
            behind = True
        if isinstance(order, Call):
            order.limits.apply()
            with line.send_heartbeats():
                reply = answer_call(order, _get_peak_memory())
            line.send(reply)
            continue
        assert isinstance(order, JobOrder)
        if workshop is None or workshop.place != order.place:
            workshop = JobRunner(order.place)
        claim, trouble = order.claim, ""
        with line.send_heartbeats(), set_log_context(claim.job_id, claim.request_id):
            try:
                workshop.run(claim)
            except INFRASTRUCTURE_ERRORS as error:
                log.warning("job %s attempt %d: %s", claim.job_id, claim.attempt, describe_error(error))
                trouble = describe_error(error)
                time.sleep(REST)
        line.send(Receipt(_get_peak_memory(), trouble))


def _lower_priority() -> None:
    """Lower the priority of this process.

    Linux divides the processor among sessions first if autogroups are on, and every child has a session of its own; so
    the session gets the same niceness.
    """
    niceness = os.nice(STANDS_BACK)
    with suppress(OSError), open("/proc/self/autogroup", "w") as group:
        group.write(str(niceness))


def _begin_tracing() -> None:
    try:
        tracing.begin_tracing()
    except ImportError as error:
        log.warning("no spans of jobs are sent: %s", error)


def _get_peak_memory() -> int:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _die_with_parent(lifeline: int) -> None:
    """Kill this process group when the other end of the pipe is closed.

    The kernel does it where it can (Linux), as a thread would have to wait for a solver that holds the interpreter's
    lock.
    """
    group = os.getpgid(0)

    def watch() -> None:
        os.read(lifeline, 1)
        os.killpg(group, signal.SIGKILL)

    if hasattr(fcntl, "F_SETSIG"):
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, -group)
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    # The thread serves other systems, and a parent that had ended before the kernel was told to watch the pipe.
    threading.Thread(target=watch, daemon=True).start()
