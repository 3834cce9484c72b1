"""Plain values that the repositories take and return, independent of tables and of the wire format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

Kind = Literal[
    "robot",
    "measurement",
    "design",
    "identification",
    "comparison",
    "diagnosis",
    "validation",
    "drive_gains",
    "current_models",
    "simulation",
    "report",
    "series",
    "import",
    "batch",
]
JobKind = Literal[
    "design",
    "identification",
    "extension",
    "removal",
    "comparison",
    "diagnosis",
    "validation",
    "drive_gains",
    "current_models",
    "simulation",
    "report",
    "series",
]
State = Literal["queued", "running", "succeeded", "failed", "cancelled"]

FINAL: frozenset[str] = frozenset({"succeeded", "failed", "cancelled"})
"""States in which a job has ended."""


@dataclass(frozen=True)
class OwnedObject:
    """Object of the object store that a resource owns."""

    role: str
    key: str
    size: int
    media_type: str


@dataclass(frozen=True)
class Dependency:
    """Dependency on another resource. `pointer` is its place in the request, which an error names."""

    id: str
    kind: Kind
    role: str
    pointer: str


@dataclass(frozen=True)
class NewJob:
    """Computation for a new resource: the function "module:name", which is called in a child process."""

    kind: JobKind
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Retry:
    """`Idempotency-Key` of a request; the fingerprint tells a repeated request from another one with the same key."""

    scope: str
    key: str
    fingerprint: str


@dataclass(frozen=True)
class NewResource:
    """Resource to be stored, with all that belongs to it, in one transaction."""

    kind: Kind
    request: Mapping[str, Any]
    name: str | None = None
    result: Mapping[str, Any] | None = None
    rests_on: tuple[Dependency, ...] = ()
    objects: tuple[OwnedObject, ...] = ()
    job: NewJob | None = None
    retry: Retry | None = None


@dataclass(frozen=True)
class Job:
    """Job as the queue stores it."""

    id: str
    kind: str
    resource_id: str | None
    state: State
    fraction: float
    message: str
    error: Mapping[str, Any] | None
    attempt: int
    created_at: datetime
    started_at: datetime | None
    finished_at: datetime | None


@dataclass(frozen=True)
class JobEvent:
    """Event in the history of a job."""

    id: int
    event: str
    data: Mapping[str, Any]


@dataclass(frozen=True)
class Resource:
    """Stored resource."""

    id: str
    kind: Kind
    name: str | None
    created_at: datetime
    request: Mapping[str, Any]
    result: Mapping[str, Any] | None
    rests_on: tuple[tuple[str, str], ...]
    """(role, id) of the resources that it depends on."""
    objects: Mapping[str, OwnedObject]
    job: Job | None
    tags: tuple[str, ...] = ()
    archived: bool = False

    def get_dependency(self, role: str) -> str:
        """Return the id of the only dependency in a role."""
        (identifier,) = self.get_dependencies(role)
        return identifier

    def get_dependencies(self, role: str) -> tuple[str, ...]:
        """Return the ids of all dependencies in a role."""
        return tuple(identifier for name, identifier in self.rests_on if name == role)


@dataclass(frozen=True)
class Page:
    """Page of a list, newest first; `cursor` leads to the next page."""

    items: tuple[Resource, ...]
    cursor: str | None
