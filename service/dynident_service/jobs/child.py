"""The child process of a job: waits on its pipe, does one job at a time.

It is a process of its own so that a computation can be stopped inside a solver: its process group is killed.
"""

from __future__ import annotations

import fcntl
import importlib
import logging
import os
import resource
import signal
import threading
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, cast

from sqlalchemy.orm import Session

from dynident.errors import Cancelled, DynidentError
from dynident_service.jobs.work import JobFunction, Memory, Outcome, Place, Task
from dynident_service.problems import ProblemError, make_problem, problem_of
from dynident_service.storage.database import Database
from dynident_service.storage.ledger import Claim, Ledger, LostClaim
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.resources import Resources, insert, own, rest
from dynident_service.storage.tables import ResourceRow

PROGRESS_INTERVAL = 0.1
SMALLEST_STEP = 0.005
log = logging.getLogger("dynident.job")


@dataclass(frozen=True)
class Order:
    """What the supervisor sends: a job, and where its data is."""

    claim: Claim
    place: Place


@dataclass(frozen=True)
class Hello:
    """What the child says first."""

    pid: int


@dataclass(frozen=True)
class Receipt:
    """What the child answers when the job has ended, well or badly (the ledger says which)."""

    peak_memory: int


class Workshop:
    """The means of a child process, opened once for all its jobs."""

    def __init__(self, place: Place) -> None:
        self.place = place
        self.database = Database(place.database_url)
        self.ledger = Ledger(self.database, place.max_attempts)
        self.objects = ObjectStore(place.object_store_url, place.cache_dir)
        self.resources = Resources(self.database, self.objects)
        self.memory = Memory()

    def do(self, claim: Claim) -> None:
        """Do a job and write its end into the ledger."""
        try:
            outcome = self._call(claim)
            self.ledger.succeed(claim, lambda session: _store(session, self.objects, claim, outcome))
        except (LostClaim, Cancelled):
            log.info("job %s attempt %d: no longer wanted", claim.job_id, claim.attempt)
            self.ledger.stopped(claim)
        except DynidentError as error:
            self.ledger.fail(claim, problem_of(error))
        except ProblemError as error:
            self.ledger.fail(claim, error.problem)
        except MemoryError:
            detail = "The computation needs more memory than there is; use less data or stronger decimation."
            self.ledger.fail(claim, make_problem(500, detail, title="Out of memory"))
        except Exception:
            log.exception("job %s attempt %d failed unexpectedly", claim.job_id, claim.attempt)
            detail = f"The computation failed unexpectedly; the service's log says where, under job {claim.job_id}."
            self.ledger.fail(claim, make_problem(500, detail))

    def _call(self, claim: Claim) -> Outcome:
        module, _, name = claim.function.partition(":")
        function = cast(JobFunction, getattr(importlib.import_module(module), name))
        found = None
        if claim.resource_id is not None:
            found = self.resources.find(claim.resource_id)
            if found is None:
                raise LostClaim(claim.job_id)
        reporter = Reporter(self.ledger, claim)
        return function(Task(found, claim.arguments, self.resources, self.objects, self.memory, reporter))


class Reporter:
    """Writes progress into the ledger, not more often than anybody can read it."""

    def __init__(self, ledger: Ledger, claim: Claim) -> None:
        self._ledger = ledger
        self._claim = claim
        self._last_time = time.monotonic()
        self._last_fraction = 0.0
        self._last_message = ""

    def __call__(self, fraction: float, message: str) -> None:
        """Report; raises LostClaim when nobody waits for the job any more."""
        moved = fraction - self._last_fraction >= SMALLEST_STEP or message != self._last_message
        if not moved or time.monotonic() - self._last_time < PROGRESS_INTERVAL:
            return
        fraction = min(1.0, max(0.0, float(fraction)))
        self._ledger.progress(self._claim, fraction, message)
        self._last_time, self._last_fraction, self._last_message = time.monotonic(), fraction, message


def _store(session: Session, objects: ObjectStore, claim: Claim, outcome: Outcome) -> None:
    result: dict[str, Any] = dict(outcome.result)
    if outcome.creates is not None:
        made = insert(session, objects, outcome.creates)
        result[f"{outcome.creates.kind}_id"] = made
        if claim.resource_id is not None:
            rest(session, claim.resource_id, made, "result")
    if claim.resource_id is not None:
        row = session.get_one(ResourceRow, claim.resource_id)
        row.result = result
        own(session, objects, row.id, outcome.objects)


def work(jobs: int, lifeline: int) -> None:
    """Do the jobs that come on a pipe, until its other end is closed; `lifeline` tells when the supervisor is gone."""
    _die_with_parent(lifeline)
    connection = Connection(jobs)
    connection.send(Hello(os.getpid()))
    workshop: Workshop | None = None
    while True:
        try:
            order = connection.recv()
        except (EOFError, OSError):
            return
        assert isinstance(order, Order)
        if workshop is None or workshop.place != order.place:
            workshop = Workshop(order.place)
        workshop.do(order.claim)
        connection.send(Receipt(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024))


def _die_with_parent(lifeline: int) -> None:
    """See to it that this process group ends when the other end of the pipe is gone.

    The kernel does it where it can (Linux), as a thread would wait for a solver that holds the interpreter's lock.
    """
    group = os.getpgid(0)

    def watch() -> None:
        os.read(lifeline, 1)
        os.killpg(group, signal.SIGKILL)

    if hasattr(fcntl, "F_SETSIG"):
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, -group)
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    # Elsewhere; and for a parent that was gone before the kernel was asked.
    threading.Thread(target=watch, daemon=True).start()
