"""What keys have stored and under way, on the wire."""

from __future__ import annotations

from pydantic import Field

from dynident_service.models.common import ViewModel


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
