"""Wake up the clients that follow jobs, by one database query for all of them."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import Collection
from dataclasses import dataclass, field

import anyio
from anyio import to_thread

from dynident_service.storage.database import AWAY
from dynident_service.storage.job_queue import JobQueue

SOONEST, LATEST = 0.01, 0.1
"""Shortest and longest time in seconds between queries, however many follow: the short one if the engine reports news,
the long one for what other processes write, such as progress.
"""
ALL = 0.5
"""Seconds between queries for all followed jobs. In between only events with new ids are looked for. These may miss
some: of two services that write at once, one may commit the smaller id later, and SQLite reuses the id of a deleted
last event.
"""
log = logging.getLogger("dynident.service")


@dataclass(frozen=True, eq=False)
class _Follower:
    job_id: str
    last: int
    news: anyio.Event = field(default_factory=anyio.Event)


class JobEventNotifier:
    """Watches for new events of jobs while anybody waits for some."""

    def __init__(self, job_queue: JobQueue) -> None:
        self._job_queue = job_queue
        self._followers: set[_Follower] = set()
        self._unseen: set[str] = set()
        """Jobs with followers that came after the last query; earlier events are reported to them too."""
        self._seen = 0
        self._looked_at_all = 0.0
        self._task: asyncio.Task[None] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None
        self._woken = asyncio.Event()

    def wake(self) -> None:
        """Report from any thread that a job has news."""
        loop = self._loop
        if loop is not None and self._followers and not loop.is_closed():
            loop.call_soon_threadsafe(self._woken.set)

    async def wait_for_news(self, job_id: str, last: int) -> None:
        """Wait until a job has events after `last`, or no longer exists."""
        follower = _Follower(job_id, last)
        self._followers.add(follower)
        # Its last events may be older than the last query, which knew nothing of this follower.
        self._unseen.add(job_id)
        if self._task is None:
            self._loop = asyncio.get_running_loop()
            self._looked_at_all = 0.0
            # One task asks for all followers, and ends with the last of them: an idle service asks nothing.
            self._task = asyncio.create_task(self._poll())
        try:
            await follower.news.wait()
        finally:
            self._followers.discard(follower)

    async def _poll(self) -> None:
        try:
            thread = anyio.CapacityLimiter(1)
            while self._followers:
                # Many reports that come at once are answered by one query.
                await asyncio.sleep(SOONEST)
                if not self._unseen:
                    await self._wait_until_woken(LATEST - SOONEST)
                followed, moment = {follower.job_id for follower in self._followers}, time.monotonic()
                is_due = moment - self._looked_at_all >= ALL
                job_ids: Collection[str] = followed if is_due else self._unseen & followed
                self._unseen = set()
                self._woken.clear()
                try:
                    newest, self._seen = await to_thread.run_sync(
                        self._job_queue.find_newest_events, self._seen, job_ids, limiter=thread
                    )
                except AWAY:
                    log.warning("the database does not answer; those who follow jobs wait")
                    self._unseen |= set(job_ids)
                    continue
                if is_due:
                    self._looked_at_all = moment
                for follower in tuple(self._followers):
                    # A job without any event was deleted; its followers are woken as well.
                    gone = follower.last + 1 if follower.job_id in job_ids else 0
                    if newest.get(follower.job_id, gone) > follower.last:
                        follower.news.set()
        finally:
            self._task = None

    async def _wait_until_woken(self, longest: float) -> None:
        try:
            async with asyncio.timeout(longest):
                await self._woken.wait()
        except TimeoutError:
            return
