"""Who takes nothing of an answer is given up; who takes it slowly is not."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import anyio
import pytest
import uvicorn
from service_helpers import wait_for

from dynident_service.serve import UNREAD_LIMIT, create_protocol
from dynident_service.settings import Settings

pytestmark = pytest.mark.skipif(not hasattr(socket, UNREAD_LIMIT), reason="this system cannot limit it")
UNREAD = 1.0
"""Seconds that a client may take nothing."""
PIECE = b"x" * 65_536


class Endless:
    """An application whose answers never end."""

    def __init__(self) -> None:
        self.left = threading.Event()

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        await receive()
        await send({"type": "http.response.start", "status": 200, "headers": []})

        async def go_on() -> None:
            while True:
                await send({"type": "http.response.body", "body": PIECE, "more_body": True})
                await anyio.sleep(0)

        async with anyio.create_task_group() as group:
            group.start_soon(go_on)
            await receive()  # only that the client has left can come
            self.left.set()
            group.cancel_scope.cancel()


@pytest.fixture
def endless() -> Endless:
    return Endless()


@pytest.fixture
def reader(endless: Endless, tmp_path: Path) -> Iterator[socket.socket]:
    """A connection over which an answer begins to come."""
    settings = Settings(data_dir=tmp_path, answer_timeout_seconds=UNREAD)
    server = uvicorn.Server(
        uvicorn.Config(endless, port=0, http=create_protocol(settings), lifespan="off", log_config=None)
    )
    thread = threading.Thread(target=server.run)
    thread.start()
    wait_for(lambda: server.started)
    with socket.socket() as opened:
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        opened.connect(server.servers[0].sockets[0].getsockname())
        opened.sendall(b"GET / HTTP/1.1\r\nhost: localhost\r\n\r\n")
        assert opened.recv(12) == b"HTTP/1.1 200"
        yield opened
    server.should_exit = True
    thread.join()


def test_who_takes_nothing_is_given_up(reader: socket.socket, endless: Endless) -> None:
    wait_for(endless.left.is_set, timeout=15 * UNREAD)


def test_who_takes_a_little_from_time_to_time_is_not(reader: socket.socket, endless: Endless) -> None:
    until = time.monotonic() + 4 * UNREAD
    while time.monotonic() < until:
        assert reader.recv(50_000)
        time.sleep(UNREAD / 5)
    assert not endless.left.is_set()
