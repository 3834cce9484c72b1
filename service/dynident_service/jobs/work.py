"""What a job's function is given, and what it gives back."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from dynident.checkpoints import Checkpoints, NoCheckpoints
from dynident.progress import Progress
from dynident_service.remembered import Remembered
from dynident_service.storage.objects import ObjectStore
from dynident_service.storage.patience import patiently
from dynident_service.storage.records import NewResource, Owned, Resource
from dynident_service.storage.resources import Resources

T = TypeVar("T")
KEPT = 16
PATIENCE = 15 * 60.0
"""How long, in seconds, what was computed waits for a database or a store that is away, or has no room."""


@dataclass(frozen=True)
class Colleagues:
    """Addresses of a Dask scheduler and of the worker that a job is on; its other workers may do parts of the job."""

    scheduler: str
    own: str


@dataclass(frozen=True)
class Place:
    """Where a child process finds the database and the objects, and those who may help it."""

    database_url: str
    object_store_url: str
    cache_dir: Path
    max_attempts: int
    deadline: float
    """Seconds that one attempt at a job may take."""
    memory: int
    """Bytes that a job may take, beside what is loaded."""
    colleagues: Colleagues | None = None


class Memory:
    """Keeps the objects that were last made, for the next job of this process."""

    def __init__(self) -> None:
        self._kept: Remembered[object] = Remembered(KEPT)

    def recall(self, kind: type[T], identifier: str, make: Callable[[], T]) -> T:
        """Give the object of an id, made anew if it is not remembered."""
        found = self._kept.get(f"{kind.__qualname__} {identifier}")
        if not isinstance(found, kind):
            found = make()
        self.keep(kind, identifier, found)
        return found

    def keep(self, kind: type[T], identifier: str, made: T) -> None:
        """Remember an object; those not asked for longest are forgotten."""
        self._kept.keep(f"{kind.__qualname__} {identifier}", made)


@dataclass(frozen=True)
class Task:
    """One job, seen from inside: what to compute, and the means to do it."""

    resource: Resource | None
    arguments: Mapping[str, Any]
    resources: Resources
    objects: ObjectStore
    memory: Memory
    progress: Progress
    checkpoints: Checkpoints = field(default_factory=NoCheckpoints)

    @property
    def subject(self) -> Resource:
        """The resource that the job computes."""
        if self.resource is None:
            raise ValueError("this job belongs to no resource")
        return self.resource

    def keep(self, role: str, content: bytes | Path, media_type: str = "application/octet-stream") -> Owned:
        """Put bytes or a file into the object store, to be owned by the resource.

        A store that is full or away is waited for: what was computed is not computed again for that.
        """
        return patiently(lambda: self.resources.put_as(role, content, media_type), PATIENCE)


@dataclass(frozen=True)
class Outcome:
    """What a job found; it is stored in one transaction with the end of the job."""

    result: Mapping[str, Any] = field(default_factory=dict)
    objects: tuple[Owned, ...] = ()
    creates: NewResource | None = None
    """A resource of its own that the job makes (a simulation makes a measurement); its id is put into the result
    under the name of its kind with `_id`."""


JobFunction = Callable[[Task], Outcome]
