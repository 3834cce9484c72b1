"""What goes to a child process and comes back: jobs with their inputs and outputs, calls, answers, heartbeats."""

from __future__ import annotations

import errno
import importlib
import logging
from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from dynident.errors import DynidentError
from dynident.progress import Checkpoints, NoCheckpoints, Progress
from dynident_service import tracing
from dynident_service.jobs.confinement import UNLIMITED, ComputationLimits, is_out_of_memory
from dynident_service.problems import Problem, ProblemError, make_problem, to_problem
from dynident_service.storage.data_directory import is_disk_full
from dynident_service.storage.database import retry_while_away
from dynident_service.storage.job_queue import JobQueue
from dynident_service.storage.job_transitions import Claim
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import NewResource, OwnedObject, Resource
from dynident_service.storage.resource_repository import Resources
from dynident_service.tracing import get_current_request, set_log_context

T = TypeVar("T")
CACHED_OBJECTS = 16
"""Number of objects that a child process caches."""
PATIENCE = 15 * 60.0
"""Seconds that a result waits for a database or an object store that is away or full."""


@dataclass(frozen=True)
class JobEnvironment:
    """Where a child process finds the database and the object store."""

    database_url: str
    object_store_url: str
    cache_dir: Path
    max_attempts: int
    deadline: float
    """Seconds that one attempt at a job may take."""
    memory: int
    """Bytes that a job may allocate, besides what is loaded."""


class LruCache(Generic[T]):
    """Values by id, of which the least recently used are dropped. For values that never change; a restart drops all."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: OrderedDict[str, T] = OrderedDict()

    def get(self, identifier: str) -> T | None:
        """Return a cached value, or None."""
        if identifier in self._kept:
            self._kept.move_to_end(identifier)
        return self._kept.get(identifier)

    def put(self, identifier: str, value: T) -> None:
        """Cache a value."""
        self._kept[identifier] = value
        self._kept.move_to_end(identifier)
        while len(self._kept) > self._most:
            self._kept.popitem(last=False)


class ObjectCache:
    """Cache of the most recently used objects, for the next jobs of this process."""

    def __init__(self) -> None:
        self._kept: LruCache[object] = LruCache(CACHED_OBJECTS)

    def get_or_make(self, kind: type[T], identifier: str, make: Callable[[], T]) -> T:
        """Return the cached object of an id, or make it."""
        value = self._kept.get(f"{kind.__qualname__} {identifier}")
        if not isinstance(value, kind):
            value = make()
        self.put(kind, identifier, value)
        return value

    def put(self, kind: type[T], identifier: str, value: T) -> None:
        """Cache an object; the least recently used ones are dropped."""
        self._kept.put(f"{kind.__qualname__} {identifier}", value)


@dataclass(frozen=True)
class Task:
    """Job as its function sees it: what to compute, and the means to do so."""

    resource: Resource | None
    arguments: Mapping[str, Any]
    resources: Resources
    objects: ObjectStore
    memory: ObjectCache
    progress: Progress
    checkpoints: Checkpoints = field(default_factory=NoCheckpoints)

    @property
    def subject(self) -> Resource:
        """Resource that the job computes."""
        if self.resource is None:
            raise ValueError("this job belongs to no resource")
        return self.resource

    def store_file(self, role: str, content: bytes | Path, media_type: str = "application/octet-stream") -> OwnedObject:
        """Put bytes or a file into the object store, to be owned by the resource.

        A store that is full or away is waited for, so that the result need not be computed again.
        """
        return retry_while_away(lambda: self.resources.put_with_role(role, content, media_type), PATIENCE)


@dataclass(frozen=True)
class Outcome:
    """Result of a job; it is stored in one transaction with the end of the job."""

    result: Mapping[str, Any] = field(default_factory=dict)
    objects: tuple[OwnedObject, ...] = ()
    creates: NewResource | None = None
    """Further resource that the job creates (a simulation creates a measurement); its id is put into the result under
    the name of its kind with `_id`.
    """
    request: Mapping[str, Any] = field(default_factory=dict)
    """Fields of the stored request that the job has decided."""


JobFunction = Callable[[Task], Outcome]


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
