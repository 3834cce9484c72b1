"""How the service ends when it is told to: first no new job, then no new request."""

from __future__ import annotations

import logging
import signal
import time
from collections.abc import Callable
from types import FrameType

import uvicorn
from anyio import CapacityLimiter, to_thread

from dynident_service.jobs.engine import Engine

log = logging.getLogger("dynident.service")


class DrainingServer(uvicorn.Server):
    """On SIGTERM lets jobs end for some seconds, while requests are still answered; then gives back what is left.

    A second signal, or Ctrl-C, ends it at once: all jobs are given back.
    """

    def __init__(self, config: uvicorn.Config, engine: Callable[[], Engine], seconds: float) -> None:
        super().__init__(config)
        self._engine = engine
        self._seconds = seconds
        self._until: float | None = None

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Take a signal; what follows is done by the next tick, as nothing may wait in here."""
        if sig != signal.SIGTERM or self._until is not None or not self.started:
            super().handle_exit(sig, frame)
        else:
            self._until = time.monotonic() + self._seconds

    async def on_tick(self, counter: int) -> bool:
        """Ten times a second: tell whether it is time to end."""
        if await super().on_tick(counter):
            return True
        if self._until is None:
            return False
        engine = self._engine()
        if engine.condition != "draining":
            log.info("draining: no job is taken any more, and those under way have %.0f s", self._seconds)
            engine.drain()
        if engine.is_busy and time.monotonic() < self._until:
            return False
        await to_thread.run_sync(engine.close, limiter=CapacityLimiter(1))
        return True
