"""Start of the service, and its end: first it takes no new jobs, then no new requests."""

from __future__ import annotations

import logging
import os
import signal
import threading
import time
from collections.abc import Callable
from importlib import import_module
from types import FrameType

import uvicorn
from anyio import CapacityLimiter, to_thread
from fastapi import FastAPI

from dynident_service import tracing
from dynident_service.app import create_app
from dynident_service.connections import create_protocol
from dynident_service.environment_secrets import forget_keys
from dynident_service.jobs.engine import Engine
from dynident_service.logs import configure_logging
from dynident_service.settings import Settings, load_settings
from dynident_service.storage.data_directory import PRIVATE, prepare_data_directory

LONGEST_END = 15.0
"""Seconds from the last job to the end of the process; what takes longer hangs, such as a request whose database does
not answer. With the 10 s that jobs have, the process ends within the 30 s that Kubernetes grants.
"""
log = logging.getLogger("dynident.service")


class DrainingServer(uvicorn.Server):
    """Server that on SIGTERM lets jobs run for some seconds while it still answers requests, and then gives them back.

    A second signal, or Ctrl-C, ends it at once, and all jobs are given back. If something hangs, the process is ended
    after `LONGEST_END`.
    """

    def __init__(self, config: uvicorn.Config, engine: Callable[[], Engine], seconds: float) -> None:
        super().__init__(config)
        self._engine = engine
        self._seconds = seconds
        self._until: float | None = None
        self._last_resort: threading.Timer | None = None

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Note a signal; a handler must not wait, so the next tick acts on it."""
        if self._last_resort is None:
            until = LONGEST_END + (self._seconds if sig == signal.SIGTERM else 0.0)
            self._last_resort = threading.Timer(until, _end_at_once)
            self._last_resort.daemon = True
            self._last_resort.start()
        # A second signal, or Ctrl-C, ends at once; before the start there is nothing to drain.
        if sig != signal.SIGTERM or self._until is not None or not self.started:
            super().handle_exit(sig, frame)
        else:
            self._until = time.monotonic() + self._seconds

    async def on_tick(self, counter: int) -> bool:
        """Return whether it is time to end; uvicorn calls this ten times a second."""
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
        # With a thread of its own: those of requests may all be taken by requests that hang.
        await to_thread.run_sync(engine.close, limiter=CapacityLimiter(1))
        return True


def _end_at_once() -> None:
    """End the process at once. Nothing is lost: its jobs are queued again when their leases have expired."""
    log.error("the service does not end by itself: a request or the database hangs; it is ended now")
    logging.shutdown()
    os._exit(1)


def serve(settings: Settings | None = None) -> None:
    """Answer requests until the process is interrupted or terminated.

    Parameters
    ----------
    settings : Settings, optional
        Settings; those of the environment by default.
    """
    settings = settings or load_settings()
    forget_keys()
    # The umask can only be read by setting it: it is set, and then set again with both.
    os.umask(os.umask(PRIVATE) | PRIVATE)
    if settings.database.startswith("postgresql"):
        # Imported here, so that a missing package is reported at once and not by a traceback during the start.
        import_module("psycopg")
    if settings.traces:
        tracing.check_packages()
    configure_logging(settings.log_level, settings.log_format)
    prepare_data_directory(settings.data_dir)
    app = create_app(settings)
    DrainingServer(build_server_config(app, settings), lambda: app.state.services.engine, settings.drain_seconds).run()


def build_server_config(app: FastAPI, settings: Settings) -> uvicorn.Config:
    """Return the configuration of the server for an application."""
    return uvicorn.Config(
        app,
        host=settings.host,
        port=settings.port,
        log_level=settings.log_level.lower(),
        log_config=None,
        access_log=False,
        timeout_graceful_shutdown=3,
        http=create_protocol(settings),
        ws="none",
        backlog=settings.max_connections,
    )
