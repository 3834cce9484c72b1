"""Answers of jobs and of usage."""

from __future__ import annotations

from datetime import datetime

from pydantic import Field

from dynident_service.problems import Problem
from dynident_service.storage.repository_values import JobKind, State
from dynident_service.wire_types.shared_types import Progress, ViewModel


class Quota(ViewModel):
    """An amount in use, and its limit."""

    used: int
    allowed: int | None = Field(description="`null` if there is no limit")


class KeyUsage(ViewModel):
    """What one key uses."""

    key: str | None = Field(
        description="Name of the key; `null` for resources without a key, or from before keys were counted"
    )
    bytes: Quota = Field(description="Of its recordings, imports and meshes; each file counts once")
    recordings: Quota = Field(description="Measurements, including those that unfinished simulations will make")
    jobs: Quota = Field(description="Queued or running")


class UsageView(ViewModel):
    """What is used, key by key."""

    items: list[KeyUsage]


class JobResource(ViewModel):
    """The resource that a job computes."""

    kind: str
    id: str
    href: str


class JobView(ViewModel):
    """A computation and its state."""

    id: str
    kind: JobKind
    state: State
    progress: Progress
    resource: JobResource | None
    error: Problem | None = None
    attempt: int = Field(description="How often it was started; more than once if a worker was lost.")
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None
