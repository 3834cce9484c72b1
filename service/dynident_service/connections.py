"""Limits for connections: how many there may be, and how long one may stay open without sending or reading."""

from __future__ import annotations

import asyncio
import json
import socket

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

from dynident_service.fair_queue import SharedPlaces, name_address_party
from dynident_service.problems import MEDIA_TYPE, make_problem
from dynident_service.security_headers import SAFE
from dynident_service.settings import Settings

UNREAD_LIMIT = "TCP_USER_TIMEOUT"
"""Name of the socket option; only Linux has it."""


def create_protocol(settings: Settings) -> type[asyncio.Protocol]:
    """Return the HTTP protocol that enforces the limits of the settings; connections are shared by address."""
    places = SharedPlaces(settings.max_connections)

    class Bounded(H11Protocol):
        """HTTP/1.1, with a bound on connections and a time within which a request must have its headers."""

        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
            super().connection_made(transport)
            self._waiting: asyncio.TimerHandle | None = None
            self._party = name_address_party({"client": self.client})
            self._has_place = places.may_take(self._party)
            _set_unread_timeout(transport, settings.answer_timeout_seconds)
            if self._has_place:
                places.take(self._party)
                self._wait_for_a_request()
            else:
                # Written as bytes: the protocol has no request yet that it could answer.
                transport.write(_build_refusal(settings.max_connections))
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
                places.give_back(self._party)
            super().connection_lost(exc)

        def _wait_for_a_request(self) -> None:
            """Begin to wait where no request has come; one that has, or has begun, is waited for no longer."""
            if self._is_idle() and self._waiting is None:
                self._waiting = self.loop.call_later(settings.header_timeout_seconds, self._give_up)
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

    return Bounded


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
        f"Too many connections are open, of {most} (DYNIDENT_MAX_CONNECTIONS), or of your share of them; "
        "try again in a moment."
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
