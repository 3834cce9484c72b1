"""Databases that can be taken away for a while."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from service_beside import free_port


class Losable(Protocol):
    """A database by its URL."""

    url: str

    def be_away(self, seconds: float) -> None:
        """Keep everybody from it for so long."""


class LockedSqlite:
    """A file of SQLite: somebody else writes, and does not end."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / "data" / "dynident.sqlite3"
        self.url = f"sqlite:///{self._path}"

    def be_away(self, seconds: float) -> None:
        """Hold the lock of those who write; it lets nobody else write, as a hung backup or disk would."""
        with closing(sqlite3.connect(self._path, timeout=60, isolation_level=None)) as connection:
            connection.execute("BEGIN EXCLUSIVE")
            time.sleep(seconds)
            connection.execute("ROLLBACK")


class CrashingPostgresql:
    """A server of PostgreSQL that is started here."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._port = free_port()
        # It refuses to run as root.
        user: dict[str, Any] = {"user": "postgres"} if os.geteuid() == 0 else {}
        self._options = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": folder, **user}
        if user:
            shutil.chown(folder, "postgres")
        made = [program("initdb"), "-D", str(folder / "data"), "-A", "trust", "-U", "dynident"]
        subprocess.run(made, check=True, **self._options)
        self.url = f"postgresql+psycopg://dynident@127.0.0.1:{self._port}/postgres"
        self._start()

    def be_away(self, seconds: float) -> None:
        """End it as a crash does, and start it again after so long."""
        self.end(signal.SIGQUIT)
        time.sleep(seconds)
        self._start()

    def end(self, how: signal.Signals = signal.SIGINT) -> None:
        """Stop the server."""
        self._server.send_signal(how)
        self._server.wait(timeout=60)

    def _start(self) -> None:
        data, port = str(self._folder / "data"), str(self._port)
        command = [program("postgres"), "-D", data, "-p", port, "-k", str(self._folder)]
        self._server = subprocess.Popen([*command, "-c", "listen_addresses=127.0.0.1"], **self._options)
        until = time.monotonic() + 60
        while time.monotonic() < until:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self._port), 1):
                return
            time.sleep(0.1)
        raise TimeoutError("PostgreSQL did not begin to listen within 60 s")


@contextmanager
def database(kind: str, folder: Path) -> Iterator[Losable]:
    """A database of a kind, `sqlite` or `postgresql`, with nothing in it."""
    if kind == "sqlite":
        yield LockedSqlite(folder)
        return
    # The user that the server runs as enters no folder of ours.
    own = Path("/tmp") / f"dynident-chaos-{os.getpid()}"
    own.mkdir()
    server = CrashingPostgresql(own)
    try:
        yield server
    finally:
        server.end()
        shutil.rmtree(own)


def program(name: str) -> str:
    """Where a program of PostgreSQL is; Debian keeps them out of the path."""
    found = shutil.which(name) or next(map(str, sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{name}"))), None)
    if found is None:
        raise SystemExit(f"{name} was not found: install PostgreSQL, or put its programs into the path")
    return found
