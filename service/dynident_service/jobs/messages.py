"""Messages between a supervisor and its child process, and what both write into the queue when a job ends."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from dynident_service.jobs.task import JobEnvironment
from dynident_service.problems import Problem, make_problem
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim

End = Callable[[JobQueue], None]
"""Writes the end of a job into the queue."""


@dataclass(frozen=True)
class JobOrder:
    """Message of the supervisor: a job, and where its data is."""

    claim: Claim
    place: JobEnvironment


@dataclass(frozen=True)
class Hello:
    """First message of the child: its process id."""

    pid: int


@dataclass(frozen=True)
class Heartbeat:
    """Message of the child from time to time while it works."""


@dataclass(frozen=True)
class Receipt:
    """Message of the child when a job has ended, well or badly; the queue says which.

    With `trouble` the job has not ended: the database or the object store was away for too long.
    """

    peak_memory: int
    trouble: str = ""


def make_memory_problem(memory: int) -> Problem:
    """Return the problem of a job that took more memory than it may; it is final, as the job would do so again."""
    detail = (
        f"The computation needs more than the {memory // 1000000} MB that a job may use (DYNIDENT_JOB_MEMORY); "
        "use less data, a stronger decimation or fewer effects. The job is not repeated."
    )
    return make_problem(500, detail, title="Out of memory")
