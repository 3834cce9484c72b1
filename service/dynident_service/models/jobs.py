"""Jobs on the wire."""

from __future__ import annotations

from datetime import datetime

from pydantic import Field

from dynident_service.models.common import Progress, ViewModel
from dynident_service.problems import Problem
from dynident_service.storage.records import JobKind, State


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
