"""What an accepted identification costs the process that answers, in processor time, whatever else the machine does.

    python benchmarks/acceptance.py
    python benchmarks/acceptance.py --requests 2000 --clients 50

The service is put beside, by HTTP as it is run, but with a scheduler that is not there: jobs are accepted and stay
queued, so that all it does is to answer. Told is the time on a processor for each answer, beside that of the lightest
one (`/healthz`), which is HTTP and nothing else.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

from common import show
from many_clients import Connection, prepare
from service_beside import served, used

NOWHERE = "tcp://127.0.0.1:9"
SETTLED = 0.02
"""The share of a processor below which the service has nothing to do any more."""


def until_idle(pid: int) -> None:
    """Wait until a service has loaded what it loads beside."""
    until = time.monotonic() + 60.0
    before = used(pid)
    while time.monotonic() < until:
        time.sleep(2.0)
        now = used(pid)
        if now - before <= 2.0 * SETTLED:
            return
        before = now


async def cost(pid: int, port: int, ask: Callable[[Connection, int], Awaitable[None]], asked: tuple[int, int]) -> float:
    """Milliseconds of processor time for each of so many requests, of so many clients at once."""
    requests, clients = asked
    connections = [Connection(port) for _ in range(clients)]

    async def client(number: int) -> None:
        for index in range(number, requests, clients):
            await ask(connections[number], index)

    for index, connection in enumerate(connections):  # warm, and connected
        await ask(connection, -1 - index)
    before = used(pid)
    await asyncio.gather(*(client(number) for number in range(clients)))
    took = used(pid) - before
    for connection in connections:
        connection.close()
    return 1e3 * took / requests


async def figures(pid: int, port: int, body: dict[str, Any], asked: tuple[int, int]) -> list[tuple[str, ...]]:
    """The cost of each kind of request."""

    def asking(method: str, path: str, content: Any = None) -> Callable[[Connection, int], Awaitable[None]]:
        async def ask(connection: Connection, _: int) -> None:
            status, _, answer = await connection.ask(method, path, content)
            assert status < 300, answer

        return ask

    made = asking("POST", "/v1/identifications", body)
    kinds = {
        "an identification accepted": made,
        "an identification looked at": asking("GET", await one_of(port)),
        "a list of ten": asking("GET", "/v1/identifications?limit=10"),
        "health": asking("GET", "/healthz"),
    }
    return [(name, f"{await cost(pid, port, ask, asked):.2f}") for name, ask in kinds.items()]


async def one_of(port: int) -> str:
    """The address of an identification that is there, with its result."""
    connection = Connection(port)
    _, _, answer = await connection.ask("GET", "/v1/identifications?limit=1")
    connection.close()
    return f"/v1/identifications/{json.loads(answer)['items'][0]['id']}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--requests", type=int, default=1000)
    parser.add_argument("--clients", type=int, default=8)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        with served(Path(folder)) as service:
            body = asyncio.run(prepare(Connection(service.port)))
        with served(Path(folder), DYNIDENT_DASK_SCHEDULER=NOWHERE, DYNIDENT_LOG_LEVEL="critical") as service:
            until_idle(service.pid)
            rows = asyncio.run(figures(service.pid, service.port, body, (asked.requests, asked.clients)))
    show(f"{asked.requests} requests of {asked.clients} clients", [("what", "ms on a processor"), *rows])


if __name__ == "__main__":
    main()
