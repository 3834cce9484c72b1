"""Tells those who follow jobs when there is news, by one look at the database for all of them."""

from __future__ import annotations

import asyncio
import logging
import time
from dataclasses import dataclass, field

import anyio
from anyio import to_thread

from dynident_service.storage.ledger import Ledger
from dynident_service.storage.patience import AWAY

SOONEST, LATEST = 0.01, 0.1
"""Seconds from one look for news to the next, however many follow."""
SHARE = 0.1
"""Who has waited for a while may wait for that share of it more: what is computed in a moment is told at once."""
log = logging.getLogger("dynident.service")


@dataclass(frozen=True, eq=False)
class _Follower:
    job_id: str
    last: int
    since: float = field(default_factory=time.monotonic)
    news: anyio.Event = field(default_factory=anyio.Event)

    @property
    def pause(self) -> float:
        """Seconds until it is looked again."""
        return min(max(SHARE * (time.monotonic() - self.since), SOONEST), LATEST)


class Following:
    """Looks for news as long as anybody waits for some."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._followers: set[_Follower] = set()
        self._task: asyncio.Task[None] | None = None

    async def until_news(self, job_id: str, last: int) -> None:
        """Wait until a job has events after one, or is there no more."""
        follower = _Follower(job_id, last)
        self._followers.add(follower)
        if self._task is None:
            self._task = asyncio.create_task(self._look())
        try:
            await follower.news.wait()
        finally:
            self._followers.discard(follower)

    async def _look(self) -> None:
        try:
            thread = anyio.CapacityLimiter(1)
            while self._followers:
                await asyncio.sleep(min(one.pause for one in self._followers))
                followed = {one.job_id for one in self._followers}
                try:
                    newest = await to_thread.run_sync(self._ledger.newest_events, followed, limiter=thread)
                except AWAY:
                    log.warning("the database is away; those who follow jobs wait")
                    continue
                for one in tuple(self._followers):
                    if one.job_id in followed and newest.get(one.job_id, one.last + 1) > one.last:
                        one.news.set()
        finally:
            self._task = None
