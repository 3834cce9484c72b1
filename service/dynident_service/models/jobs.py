"""Jobs on the wire, and what keys have stored and under way."""

from __future__ import annotations

from datetime import datetime

from pydantic import Field

from dynident_service.models.common import Progress, ViewModel
from dynident_service.problems import Problem
from dynident_service.storage.records import JobKind, State


class Quota(ViewModel):
    """How much there is of one thing, and how much there may be."""

    used: int
    allowed: int | None = Field(description="`null` where there is no limit")


class KeyUsage(ViewModel):
    """What one key has."""

    key: str | None = Field(description="Its name; `null` has what no key sent, and what was there before keys counted")
    bytes: Quota = Field(description="Of its recordings, imports and meshes; each file once, however often it is used")
    recordings: Quota = Field(description="Measurements, with those that simulations under way will give")
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
    """A computation: where it stands."""

    id: str
    kind: JobKind
    state: State
    progress: Progress
    resource: JobResource | None
    error: Problem | None = None
    attempt: int = Field(description="How often it was begun; more than once where a worker was lost.")
    created_at: datetime
    started_at: datetime | None = None
    finished_at: datetime | None = None
