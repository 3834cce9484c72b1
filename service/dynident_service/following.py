"""Tells those who follow jobs when there is news, by one look at the database for all of them."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Collection
from dataclasses import dataclass, field

import anyio
from anyio import to_thread

from dynident_service.storage.ledger import Ledger
from dynident_service.storage.patience import AWAY

SOONEST, LATEST = 0.01, 0.1
"""Seconds from one look for news to the next, however many follow: at once where the engine says that there is some,
else what others write (how far a job is, what another service does) is looked for."""
ALL = 0.5
"""Seconds from one look at all that are followed to the next. In between it is looked for new events alone, by their
ids: of two services that write at once one may store the smaller id last, and SQLite gives the id of a deleted last
event again."""
log = logging.getLogger("dynident.service")


@dataclass(frozen=True, eq=False)
class _Follower:
    job_id: str
    last: int
    news: anyio.Event = field(default_factory=anyio.Event)


class Following:
    """Looks for news as long as anybody waits for some."""

    def __init__(self, ledger: Ledger) -> None:
        self._ledger = ledger
        self._followers: set[_Follower] = set()
        self._unseen: set[str] = set()
        """Jobs whose followers came after the last look: what happened before is told to them, too."""
        self._seen = 0
        self._looked_at_all = 0.0
        self._task: asyncio.Task[None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._told = asyncio.Event()

    def nudge(self) -> None:
        """Say, in whatever thread, that a job has news."""
        loop = self._loop
        if loop is not None and self._followers and not loop.is_closed():
            loop.call_soon_threadsafe(self._told.set)

    async def until_news(self, job_id: str, last: int) -> None:
        """Wait until a job has events after one, or is there no more."""
        follower = _Follower(job_id, last)
        self._followers.add(follower)
        self._unseen.add(job_id)
        if self._task is None:
            self._loop = asyncio.get_running_loop()
            self._looked_at_all = 0.0
            self._task = asyncio.create_task(self._look())
        try:
            await follower.news.wait()
        finally:
            self._followers.discard(follower)

    async def _look(self) -> None:
        try:
            thread = anyio.CapacityLimiter(1)
            while self._followers:
                await asyncio.sleep(SOONEST)
                if not self._unseen:
                    await self._until_told(LATEST - SOONEST)
                followed, moment = {one.job_id for one in self._followers}, time.monotonic()
                is_due = moment - self._looked_at_all >= ALL
                asked: Collection[str] = followed if is_due else self._unseen & followed
                self._unseen = set()
                self._told.clear()
                try:
                    newest, self._seen = await to_thread.run_sync(self._ledger.news, self._seen, asked, limiter=thread)
                except AWAY:
                    log.warning("the database is away; those who follow jobs wait")
                    self._unseen |= set(asked)
                    continue
                if is_due:
                    self._looked_at_all = moment
                for one in tuple(self._followers):
                    gone = one.last + 1 if one.job_id in asked else 0
                    if newest.get(one.job_id, gone) > one.last:
                        one.news.set()
        finally:
            self._task = None

    async def _until_told(self, longest: float) -> None:
        try:
            async with asyncio.timeout(longest):
                await self._told.wait()
        except TimeoutError:
            return
