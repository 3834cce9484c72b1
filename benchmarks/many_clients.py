"""Many clients at once against one service: how long an accepted job and the health route take, and how memory goes.

    python benchmarks/many_clients.py --clients 50 --seconds 60
    python benchmarks/many_clients.py --clients 1000 --seconds 20

Each client posts an identification, follows its job until it ends, reads the result and the list, and begins again.
The service runs beside, on the default SQLite file in a folder of its own, with all cores; health is asked ten times
a second. A client that is told 429 or 503 waits as long as Retry-After says, as clients should.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tempfile
import time
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from common import show
from service_beside import served, used

BUSY = frozenset({429, 503})
SLOWEST = 60.0
"""Seconds after which an answer counts as a hang."""


@dataclass
class Tally:
    """What all clients saw: seconds by kind of request, answers that are none, jobs that ended."""

    seconds: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    refused: Counter[int] = field(default_factory=Counter)
    troubles: Counter[str] = field(default_factory=Counter)
    ended: Counter[str] = field(default_factory=Counter)
    memory: list[tuple[float, float]] = field(default_factory=list)


class Connection:
    """One kept-alive connection to the service."""

    def __init__(self, port: int, key: str = "") -> None:
        self._port = port
        self._key = f"x-api-key: {key}\r\n" if key else ""
        self._reader: asyncio.StreamReader | None = None
        self._writer: asyncio.StreamWriter | None = None

    async def ask(self, method: str, path: str, body: Any = None) -> tuple[int, dict[str, str], bytes]:
        """Send a request and read the whole answer: status, headers, content."""
        if self._reader is None:
            self._reader, self._writer = await asyncio.open_connection("127.0.0.1", self._port)
        assert self._writer is not None
        content = b"" if body is None else json.dumps(body).encode()
        head = f"{method} {path} HTTP/1.1\r\nhost: localhost\r\ncontent-type: application/json\r\n"
        self._writer.write(f"{head}{self._key}content-length: {len(content)}\r\n\r\n".encode() + content)
        try:
            lines = (await self._reader.readuntil(b"\r\n\r\n")).decode().split("\r\n")
            headers = {name.lower(): value.strip() for name, _, value in (line.partition(":") for line in lines[1:])}
            answer = await self._content(self._reader, headers)
        except BaseException:
            self.close()
            raise
        if headers.get("connection") == "close":
            self.close()
        return int(lines[0].split()[1]), headers, answer

    def close(self) -> None:
        """Let go of it; the next request opens another."""
        if self._writer is not None:
            self._writer.close()
        self._reader = self._writer = None

    @staticmethod
    async def _content(reader: asyncio.StreamReader, headers: dict[str, str]) -> bytes:
        if headers.get("transfer-encoding") != "chunked":
            return await reader.readexactly(int(headers.get("content-length", 0)))
        parts = []
        while size := int(await reader.readline(), 16):
            parts.append(await reader.readexactly(size))
            await reader.readline()
        await reader.readline()
        return b"".join(parts)


async def client(port: int, until: float, body: dict[str, Any], tally: Tally) -> None:
    """Work as one user does, until the time is over."""
    connection = Connection(port)

    async def ask(kind: str, method: str, path: str, content: Any = None) -> Any:
        while time.monotonic() < until:
            began = time.perf_counter()
            try:
                async with asyncio.timeout(SLOWEST):
                    status, headers, answer = await connection.ask(method, path, content)
            except (OSError, EOFError, TimeoutError) as error:
                tally.troubles[f"{kind}: {type(error).__name__}"] += 1
                await asyncio.sleep(1.0)
                continue
            took = time.perf_counter() - began
            if status in BUSY:
                tally.refused[status] += 1
                tally.seconds["refused"].append(took)
                await asyncio.sleep(float(headers.get("retry-after", 1)))
                continue
            if status >= 400:
                tally.troubles[f"{kind}: {status}"] += 1
            tally.seconds[kind].append(took)
            return json.loads(answer) if headers["content-type"].startswith("application/json") else answer
        raise TimeoutError

    with suppress(TimeoutError):
        while True:
            made = await ask("accept", "POST", "/v1/identifications", body)
            events = await ask("follow", "GET", f"/v1/jobs/{made['job_id']}/events")
            tally.ended[json.loads(events.rstrip().rpartition(b"data: ")[2].splitlines()[0])["state"]] += 1
            await ask("result", "GET", f"/v1/identifications/{made['id']}")
            await ask("list", "GET", "/v1/identifications?limit=10")
    connection.close()


async def watch(port: int, pid: int, until: float, tally: Tally) -> None:
    """Ask for the health and the memory of the service, again and again."""
    connection, began = Connection(port), time.monotonic()
    while (moment := time.monotonic()) < until:
        for path in ("/healthz", "/readyz") if len(tally.memory) % 10 == 0 else ("/healthz",):
            start = time.perf_counter()
            try:
                status, _, _ = await connection.ask("GET", path)
            except (OSError, EOFError) as error:
                tally.troubles[f"{path}: {type(error).__name__}"] += 1
                continue
            tally.seconds[path].append(time.perf_counter() - start)
            if status != 200:
                tally.troubles[f"{path}: {status}"] += 1
        tally.memory.append((moment - began, resident(pid)))
        await asyncio.sleep(0.1)
    connection.close()


def resident(pid: int) -> float:
    """Resident memory of a process in MB."""
    with suppress(OSError):
        for line in Path(f"/proc/{pid}/status").read_text().splitlines():
            if line.startswith("VmRSS"):
                return int(line.split()[1]) / 1e3
    return 0.0


async def make_resource(connection: Connection, path: str, body: dict[str, Any]) -> dict[str, Any]:
    """Ask for a resource, and wait until it is computed."""
    status, headers, answer = await connection.ask("POST", path, body)
    assert status < 300, answer
    resource = json.loads(answer)
    while resource.get("status", "succeeded") in ("queued", "running"):
        await asyncio.sleep(0.05)
        resource = json.loads((await connection.ask("GET", headers["location"]))[2])
    assert resource.get("status", "succeeded") == "succeeded", resource
    return dict(resource)


async def prepare(connection: Connection) -> dict[str, Any]:
    """Make a robot and a recording; gives the body that identifies it, once it was done."""
    from dynident.robot import library_table

    description = {"format": "modified_dh", "content": library_table("scara")}
    robot = await make_resource(connection, "/v1/robots", {"name": "scara", "description": description})
    recording = await make_recording(connection, robot["id"], 10.0, 200.0)
    body = {"robot_id": robot["id"], "measurement_ids": [recording]}
    await make_resource(connection, "/v1/identifications", body)
    connection.close()
    return body


async def make_recording(connection: Connection, robot_id: str, duration: float, sampling_rate: float) -> str:
    """Have a virtual robot measured; gives the id of the recording."""
    trajectory = {"duration": duration, "sampling_rate": sampling_rate}
    virtual = {"robot_id": robot_id, "effects": [{"effect": "coulomb"}], "trajectory": trajectory, "seed": 1}
    made = await make_resource(connection, "/v1/simulations", virtual)
    return str(made["result"]["measurement_id"])


async def lean_on(port: int, pid: int, body: dict[str, Any], clients: int, seconds: float) -> Tally:
    """Have so many clients work for so long."""
    tally = Tally()
    until = time.monotonic() + seconds
    await asyncio.gather(watch(port, pid, until, tally), *(client(port, until, body, tally) for _ in range(clients)))
    return tally


def at(share: float, values: list[float]) -> str:
    """The value that so large a share of them does not exceed, in ms."""
    return f"{1e3 * sorted(values)[min(len(values) - 1, int(share * len(values)))]:.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--clients", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=60.0)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, served(Path(folder)) as service:
        body, before = asyncio.run(prepare(Connection(service.port))), used(service.pid)
        tally = asyncio.run(lean_on(service.port, service.pid, body, asked.clients, asked.seconds))
        each = 1e3 * (used(service.pid) - before) / max(1, tally.ended.total())
    rows = [("request", "times", "p50 ms", "p99 ms", "longest ms")]
    for kind, values in tally.seconds.items():
        rows.append((kind, str(len(values)), at(0.5, values), at(0.99, values), at(1.0, values)))
    show(f"{asked.clients} clients for {asked.seconds:.0f} s", rows)
    print(f"\n  jobs that ended: {dict(tally.ended)}; refused: {dict(tally.refused)}; wrong: {dict(tally.troubles)}")
    print(f"  time on a processor, of the service without its computations: {each:.1f} ms for each job that ended")
    later = [value for when, value in tally.memory if when >= min(20.0, asked.seconds / 2)]
    print(
        f"  memory of the service, MB: {later[0]:.0f} after a while, {later[-1]:.0f} at the end, {max(later):.0f} most"
    )


if __name__ == "__main__":
    main()
