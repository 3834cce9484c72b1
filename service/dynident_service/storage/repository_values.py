"""Types that the repository takes and returns (`Resource`, `Job`, …), and new identifiers by kind."""

from __future__ import annotations

import secrets
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Any, Literal

GEOMETRY = "geometry"
CHANGED = "Changed at the same time"
"""Title of the problem that another request has changed a resource meanwhile."""


def get_mesh_role(place: int) -> str:
    """Return the role of a mesh file; `place` is the position of the mesh in the robot's description."""
    return f"mesh-{place}"


def find_mesh_files(robot: Resource) -> dict[str, OwnedObject]:
    """Return the mesh files that a robot has, by mesh name."""
    named = enumerate((robot.result or {}).get("meshes", []))
    owned = ((mesh["name"], robot.objects.get(get_mesh_role(place))) for place, mesh in named)
    return {name: file for name, file in owned if file is not None}


def list_meshes(robot: Resource) -> list[dict[str, object]]:
    """Return all meshes that a robot's description names, with hash and size of the files that the robot has."""
    files = find_mesh_files(robot)
    return [
        {**mesh, "sha256": files[mesh["name"]].key, "size": files[mesh["name"]].size} if mesh["name"] in files else mesh
        for mesh in (robot.result or {}).get("meshes", [])
    ]


ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"
"""Crockford's base 32: no letters that are easily confused, and in the order of ASCII."""
PREFIXES = {
    "robot": "rob",
    "measurement": "mea",
    "design": "des",
    "identification": "idn",
    "comparison": "cmp",
    "diagnosis": "dia",
    "validation": "val",
    "drive_gains": "gai",
    "current_models": "cur",
    "simulation": "sim",
    "report": "rep",
    "series": "ser",
    "import": "imp",
    "batch": "bat",
    "campaign": "cam",
    "next_experiment": "nex",
    "job": "job",
}
KINDS = {prefix: kind for kind, prefix in PREFIXES.items()}


class _NumberSequence:
    """Source of increasing 128-bit numbers: 48 bits of time in milliseconds, 80 random bits.

    Within one millisecond, or after the clock was set back, a number is the previous one plus a random step. Lists and
    queues therefore keep the order in which one process created their entries.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = 0

    def draw_number(self) -> int:
        fresh = (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80)
        with self._lock:
            # The step is 64 bits of chance: nobody guesses the next identifier from the last.
            # `behind` also covers a clock that was set back.
            behind = fresh >> 80 <= self._last >> 80
            self._last = self._last + 1 + secrets.randbits(64) if behind else fresh
            return self._last


_CLOCK = _NumberSequence()


def create_identifier(kind: str) -> str:
    """Return a new identifier: the prefix of its kind and a 128-bit number in Crockford's base 32."""
    number = _CLOCK.draw_number()
    # 26 digits of 5 bits are 130 bits; the first digit holds only the upper 3 of the 128.
    digits = [ALPHABET[number >> shift & 31] for shift in range(125, -1, -5)]
    return f"{PREFIXES[kind]}_{''.join(digits)}"


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
    "campaign",
    "next_experiment",
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
    "next_experiment",
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
class Siblings:
    """Resources of a kind that depend on the same one, as a request saw them when it decided what to store."""

    on_id: str
    ids: tuple[str, ...]


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
    siblings: Siblings | None = None
    """It is stored only if no others of its kind have come since."""


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
