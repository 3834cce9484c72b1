"""The fork server as the service sees it: starts the process, has it fork children, and asks how they ended.

What runs in that process is in `fork_server_main`; it is kept apart so that what children do is not imported here.
"""

from __future__ import annotations

import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from dynident_service.environment_secrets import build_child_environment, open_child_secrets

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Environment that keeps linear algebra to one thread, as a process that forks must not have others."""
BOUNDED_ARROW = {"ARROW_DEFAULT_MEMORY_POOL": "system"}
"""Environment for Arrow, whose own allocator reserves 1 GB of addresses at once; limits of children would count it."""
MESSAGE = struct.Struct("!iiq")
"""Message in both directions: kind, process id or exit code, and peak memory."""
FORK, REAP, LOOK = 1, 2, 3
RUNNING = 1 << 20
"""Exit code that stands for a process that still runs."""


class ProcessExit(NamedTuple):
    """End of a process: its exit code, negative for a signal, and its peak memory in bytes."""

    code: int
    peak_memory: int


class ForkServer:
    """Client of the process that forks children; starts it when it is needed."""

    PROGRAM: ClassVar[Sequence[str]] = ("-m", "dynident_service.jobs.fork_server_main")
    """Arguments of Python that run `fork_server_main.main`; tests put code before it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    def fork(self, jobs: int, lifeline: int) -> None:
        """Fork a child that serves the pipe `jobs`; it appears once the science is imported.

        Parameters
        ----------
        jobs : int
            File descriptor of the pipe with jobs and calls.
        lifeline : int
            File descriptor of the pipe whose closing ends the child.
        """
        with self._lock:
            try:
                self._send_fork(jobs, lifeline)
            except OSError:  # it has died: begin with a new one
                self._stop()
                self._send_fork(jobs, lifeline)

    def get_exit(self, pid: int, *, reap: bool) -> ProcessExit | None:
        """Return how a child ended; None while it runs, or if the fork server itself has died.

        With `reap` the child is waited for, after which its process id may be used again; only then its peak memory is
        known.
        """
        with self._lock:
            if self._control is None:
                return None
            try:
                self._control.sendall(MESSAGE.pack(REAP if reap else LOOK, pid, 0))
                _, code, peak_memory = MESSAGE.unpack(receive_exactly(self._control))
            except OSError:
                return None
        return None if code == RUNNING else ProcessExit(code, peak_memory)

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._stop()

    def _send_fork(self, jobs: int, lifeline: int) -> None:
        control = self._control or self._start()
        socket.send_fds(control, [MESSAGE.pack(FORK, 0, 0)], [jobs, lifeline])

    def _start(self) -> socket.socket:
        ours, theirs = socket.socketpair()
        with theirs, open_child_secrets() as secrets:
            self._process = subprocess.Popen(
                [sys.executable, *self.PROGRAM, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=secrets,
                env={**build_child_environment(), **ONE_THREAD, **BOUNDED_ARROW},
                start_new_session=True,
            )
        self._control = ours
        return ours

    def _stop(self) -> None:
        if self._control is not None:
            self._control.close()
            self._control = None
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


def receive_exactly(control: socket.socket, size: int = MESSAGE.size) -> bytes:
    """Return the next `size` bytes of a socket; raise ConnectionError if its other end is closed before."""
    content = b""
    while len(content) < size:
        part = control.recv(size - len(content))
        if not part:
            raise ConnectionError("the other end is closed")
        content += part
    return content
