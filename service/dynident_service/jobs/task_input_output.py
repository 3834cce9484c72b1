"""What a job gets and gives: its inputs, outputs and environment; cache of recently used values."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from dynident.progress import Checkpoints, NoCheckpoints, Progress
from dynident_service.storage.object_store import ObjectStore
from dynident_service.storage.repository_values import NewResource, OwnedObject, Resource
from dynident_service.storage.resource_repository import Resources
from dynident_service.storage.retry_while_away import retry_while_away

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
