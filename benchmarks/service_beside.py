"""A service in a process of its own, beside whoever measures it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class Beside:
    """A service that listens on a port of this machine."""

    port: int
    pid: int

    @property
    def url(self) -> str:
        """Where it is."""
        return f"http://127.0.0.1:{self.port}"


@contextmanager
def served(folder: Path, **more: str) -> Iterator[Beside]:
    """A service on the default database in a folder, until it is not needed; `more`: settings by their variables."""
    port = free_port()
    settings = {"DYNIDENT_DATA_DIR": str(folder), "DYNIDENT_PORT": str(port), "DYNIDENT_LOG_LEVEL": "error", **more}
    process = subprocess.Popen([sys.executable, "-m", "dynident_service"], env={**os.environ, **settings})
    try:
        wait_until_it_answers(port)
        yield Beside(port, process.pid)
    finally:
        process.terminate()
        process.wait()


def used(pid: int) -> float:
    """Processor time of a process so far, in seconds; not that of its children."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def free_port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until_it_answers(port: int) -> None:
    """Wait until the service listens."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return
        time.sleep(0.1)
    raise TimeoutError("the service did not begin to listen within 60 s")
