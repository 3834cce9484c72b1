"""Batches of identifications on the wire."""

from __future__ import annotations

from datetime import datetime

from pydantic import Field

from dynident_service.models.common import Asked, Shown
from dynident_service.models.identifications import IdentificationRequest
from dynident_service.storage.records import State


class BatchRequest(Asked):
    """Many identifications, each as `POST /v1/identifications` takes it: all of them are accepted, or none."""

    items: list[IdentificationRequest] = Field(min_length=1, description="As many as DYNIDENT_MAX_BATCH, or fewer")


class BatchItem(Shown):
    """One identification of a batch."""

    id: str
    job_id: str
    status: State


class BatchView(Shown):
    """Identifications that were asked for together."""

    id: str
    created_at: datetime
    states: dict[State, int] = Field(description="How many there are in each state; those with none are left out.")
    items: list[BatchItem] = Field(description="In the order of the request, without those that were deleted since.")
