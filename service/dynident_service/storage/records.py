"""What the repositories give and take: plain values, apart from the tables and from the wire."""

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


@dataclass(frozen=True)
class Owned:
    """An object of the object store that a resource owns."""

    role: str
    key: str
    size: int
    media_type: str


@dataclass(frozen=True)
class RestsOn:
    """A resource that another one needs; `pointer` is where the request names it, so that an error can say so."""

    id: str
    kind: Kind
    role: str
    pointer: str


@dataclass(frozen=True)
class NewJob:
    """A computation to be done for a new resource: the function "module:name" is called in a child process."""

    kind: JobKind
    function: str
    arguments: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Retry:
    """The `Idempotency-Key` of a request; the fingerprint tells a retry from another request with the same key."""

    scope: str
    key: str
    fingerprint: str


@dataclass(frozen=True)
class NewResource:
    """A resource to be stored, with all that belongs to it, in one transaction."""

    kind: Kind
    request: Mapping[str, Any]
    name: str | None = None
    result: Mapping[str, Any] | None = None
    rests_on: tuple[RestsOn, ...] = ()
    objects: tuple[Owned, ...] = ()
    job: NewJob | None = None
    retry: Retry | None = None


@dataclass(frozen=True)
class Job:
    """A job as the ledger knows it."""

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
    """One event of a job's history."""

    id: int
    event: str
    data: Mapping[str, Any]


@dataclass(frozen=True)
class Resource:
    """A stored resource."""

    id: str
    kind: Kind
    name: str | None
    created_at: datetime
    request: Mapping[str, Any]
    result: Mapping[str, Any] | None
    rests_on: tuple[tuple[str, str], ...]
    """(role, id) of the resources that it needs."""
    objects: Mapping[str, Owned]
    job: Job | None
    tags: tuple[str, ...] = ()
    archived: bool = False

    def one(self, role: str) -> str:
        """Give the id of the one resource that it needs in a role."""
        (found,) = self.all(role)
        return found

    def all(self, role: str) -> tuple[str, ...]:
        """Give the ids of the resources that it needs in a role."""
        return tuple(identifier for name, identifier in self.rests_on if name == role)


@dataclass(frozen=True)
class Page:
    """A part of a list, newest first; `cursor` gives the next part."""

    items: tuple[Resource, ...]
    cursor: str | None
