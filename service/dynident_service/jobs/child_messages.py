"""Messages between the service and its child processes: jobs, calls, answers, heartbeats."""

from __future__ import annotations

import errno
import importlib
import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from dynident.errors import DynidentError
from dynident_service import tracing
from dynident_service.jobs.confinement import UNLIMITED, ComputationLimits, is_out_of_memory
from dynident_service.jobs.task_input_output import JobEnvironment
from dynident_service.log_lines import get_current_request, set_log_context
from dynident_service.problems import Problem, ProblemError, make_problem, to_problem
from dynident_service.storage.data_directory import is_disk_full
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


log = logging.getLogger("dynident.job")


@dataclass(frozen=True)
class Call:
    """Call of a function "module:name" that takes plain values by keyword and returns plain values."""

    function: str
    arguments: Mapping[str, Any]
    request_id: str | None = field(default_factory=get_current_request)
    trace: str | None = field(default_factory=tracing.get_current_span)
    limits: ComputationLimits = UNLIMITED


@dataclass(frozen=True)
class Answer:
    """Return value of a call, or the problem that prevented it, with the peak memory of the child process in bytes."""

    peak_memory: int
    value: Any = None
    problem: Problem | None = None


def answer_call(call: Call, peak_memory: int) -> Answer:
    """Do a call, and turn every exception into a problem."""
    with set_log_context(None, call.request_id), tracing.trace_task(f"compute {call.function}", call.trace):
        return _run_call(call, peak_memory)


def confirm_readiness() -> bool:
    """Return True: the service calls this to see whether a child process would answer a request."""
    return True


def _run_call(call: Call, peak_memory: int) -> Answer:
    module, _, name = call.function.partition(":")
    try:
        value = getattr(importlib.import_module(module), name)(**call.arguments)
    except (DynidentError, ProblemError) as error:
        return Answer(peak_memory, problem=to_problem(error))
    except Exception as error:
        if is_out_of_memory(error):
            detail = "The data need more memory than one request may use; send less at a time."
            return Answer(peak_memory, problem=make_problem(422, detail, title="Out of memory"))
        # The process is confined to the files of the request, so a file of the user pointed elsewhere.
        if isinstance(error, PermissionError):
            log.exception("the call of %s tried an access that is not allowed", call.function)
            detail = (
                "The data refer to something outside themselves, which the service does not read; send everything "
                "in one file."
            )
            return Answer(peak_memory, problem=make_problem(422, detail, title="Points elsewhere"))
        # RLIMIT_FSIZE stopped a write; see Limits.
        if isinstance(error, OSError) and error.errno == errno.EFBIG:
            detail = "The answer is larger than one request may write; ask for less at a time."
            return Answer(peak_memory, problem=make_problem(413, detail, title="Answer too large"))
        if is_disk_full(error):
            return Answer(peak_memory, problem=make_problem(507, "The disk of the service is full.", title="Disk full"))
        log.exception("the call of %s failed unexpectedly", call.function)
        return Answer(peak_memory, problem=make_problem(500, "The service failed unexpectedly; its log says where."))
    return Answer(peak_memory, value=value)
