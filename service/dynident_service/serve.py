"""Start uvicorn with connection limits, and stop: first no new jobs, then no new requests (15 s)."""

from __future__ import annotations

import asyncio
import json
import logging
import os
import signal
import socket
import threading
import time
from collections.abc import Callable
from importlib import import_module
from types import FrameType
from typing import ClassVar

import h11
import uvicorn
from anyio import CapacityLimiter, to_thread
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from dynident_service import tracing
from dynident_service.app import create_app
from dynident_service.environment_secrets import forget_keys
from dynident_service.fair_queue import SharedPlaces, name_address_party
from dynident_service.jobs.job_engine import Engine
from dynident_service.problem_responses import SAFE
from dynident_service.problems import MEDIA_TYPE, make_problem
from dynident_service.settings import Settings, load_settings
from dynident_service.storage.data_directory import PRIVATE, prepare_data_directory
from dynident_service.tracing import configure_logging

UNREAD_LIMIT = "TCP_USER_TIMEOUT"
"""Name of the socket option; only Linux has it."""


class _BoundedProtocol(H11Protocol):
    """HTTP/1.1, with a bound on connections and a time within which a request must have its headers."""

    settings: ClassVar[Settings]
    places: ClassVar[SharedPlaces]

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._waiting: asyncio.TimerHandle | None = None
        self._party = name_address_party({"client": self.client})
        self._has_place = self.places.may_take(self._party)
        _set_unread_timeout(transport, self.settings.answer_timeout_seconds)
        if self._has_place:
            self.places.take(self._party)
            self._wait_for_a_request()
        else:
            # Written as bytes: the protocol has no request yet that it could answer.
            transport.write(_build_refusal(self.settings.max_connections))
            transport.close()

    def data_received(self, data: bytes) -> None:
        if self.transport.is_closing():
            return
        super().data_received(data)
        self._wait_for_a_request()

    def connection_lost(self, exc: Exception | None) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
        if self._has_place:
            self.places.give_back(self._party)
        super().connection_lost(exc)

    def _wait_for_a_request(self) -> None:
        """Begin to wait where no request has come; one that has, or has begun, is waited for no longer."""
        if self._is_idle() and self._waiting is None:
            self._waiting = self.loop.call_later(self.settings.header_timeout_seconds, self._give_up)
        elif not self._is_idle() and self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _give_up(self) -> None:
        self._waiting = None
        if self._is_idle() and not self.transport.is_closing():
            self.transport.close()

    def _is_idle(self) -> bool:
        """Tell whether nothing is to be answered: no request has come, or only the rest of an answered one does."""
        is_answered = self.conn.our_state in (h11.DONE, h11.MUST_CLOSE)
        return self.conn.their_state is h11.IDLE or (is_answered and self.conn.their_state is h11.SEND_BODY)


def create_protocol(settings: Settings) -> type[asyncio.Protocol]:
    """Return the HTTP protocol that enforces the limits of the settings; connections are shared by address."""
    # The server makes an object of this class for each connection, so what they share stands on the class.
    shared = {"settings": settings, "places": SharedPlaces(settings.max_connections)}
    return type("BoundedProtocol", (_BoundedProtocol,), shared)


def _set_unread_timeout(transport: asyncio.Transport, seconds: float) -> None:
    """Have the kernel close a connection whose client reads nothing for so long.

    Systems other than Linux lack this option. A client that reads nothing then occupies places of its own share only.
    """
    opened: socket.socket | None = transport.get_extra_info("socket")
    if opened is not None and opened.family in (socket.AF_INET, socket.AF_INET6) and hasattr(socket, UNREAD_LIMIT):
        opened.setsockopt(socket.IPPROTO_TCP, getattr(socket, UNREAD_LIMIT), max(1, round(1000 * seconds)))


def _build_refusal(most: int) -> bytes:
    """Return the complete answer for a connection that is one too many."""
    detail = (
        f"Too many connections are open: the service allows {most} (DYNIDENT_MAX_CONNECTIONS), and each caller a "
        "share of them; try again in a moment."
    )
    body = json.dumps(make_problem(503, detail, title="Too busy").model_dump(exclude_none=True)).encode()
    head = (
        "HTTP/1.1 503 Service Unavailable\r\n"
        f"content-type: {MEDIA_TYPE}\r\ncontent-length: {len(body)}\r\n"
        "retry-after: 1\r\nconnection: close\r\n"
        + "".join(f"{name}: {value}\r\n" for name, value in SAFE.items())
        + "\r\n"
    )
    return head.encode() + body


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
            log.info("draining: the service starts no more jobs; running jobs have %.0f s", self._seconds)
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
    """Answer requests until the process is interrupted or terminated."""
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
