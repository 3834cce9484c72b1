"""The process that child processes are forked from: it has imported the science once, so a new child starts at once.

It is single-threaded (except for Arrow's own thread, which Arrow handles at a fork) and does nothing else: it forks on
request and reports how a child ended.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import signal
import socket
import struct
import subprocess
import sys
import threading
import warnings
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

from dynident_service.environment_secrets import build_child_environment, open_child_secrets, take_secrets
from dynident_service.jobs import child
from dynident_service.logs import configure_logging
from dynident_service.settings import LogSettings

PRELOADED = ("dynident_service.work", "dynident_service.work.interactive")
"""Modules that are imported before the first fork."""
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

    PROGRAM: ClassVar[Sequence[str]] = ("-m", "dynident_service.jobs.fork_server")
    """Arguments of Python that run `main`; tests put code before it."""

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
        """Return how a child ended; None while it runs, or if the nursery itself has died.

        With `reap` the child is waited for, after which its process id may be used again; only then its peak memory is
        known.
        """
        with self._lock:
            if self._control is None:
                return None
            try:
                self._control.sendall(MESSAGE.pack(REAP if reap else LOOK, pid, 0))
                _, code, peak_memory = MESSAGE.unpack(_receive_exactly(self._control))
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


def main() -> None:
    """Import the science, then fork children on request until the other end of the socket is closed."""
    take_secrets()
    control = socket.socket(fileno=int(sys.argv[1]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # what solvers print belongs to the log
    settings = LogSettings()
    configure_logging(settings.log_level, settings.log_format)
    warnings.filterwarnings("ignore", message=".*fork.*", category=DeprecationWarning)
    for module in PRELOADED:
        importlib.import_module(module)
    gc.freeze()  # garbage collection in a child would copy shared memory
    while True:
        try:
            received, fds = _receive(control)
        except OSError:
            return
        kind, pid, _ = MESSAGE.unpack(received)
        if kind != FORK:
            control.sendall(MESSAGE.pack(kind, *_get_exit(pid, reap=kind == REAP)))
        elif os.fork() == 0:
            control.close()
            # A session and process group of its own, so that the child can be killed with all processes that it starts.
            os.setsid()
            child.serve_jobs(*fds)
            os._exit(0)
        for fd in fds:
            os.close(fd)


def _receive(control: socket.socket) -> tuple[bytes, list[int]]:
    received, fds, _, _ = socket.recv_fds(control, MESSAGE.size, 2)
    if not received:
        raise ConnectionError("the other end is closed")
    return received + _receive_exactly(control, MESSAGE.size - len(received)), list(fds)


def _receive_exactly(control: socket.socket, size: int = MESSAGE.size) -> bytes:
    content = b""
    while len(content) < size:
        part = control.recv(size - len(content))
        if not part:
            raise ConnectionError("the other end is closed")
        content += part
    return content


def _get_exit(pid: int, *, reap: bool) -> ProcessExit:
    """Return how a child ended, or RUNNING; without `reap` its process id stays reserved."""
    with contextlib.suppress(ChildProcessError):
        if reap:
            _, status, usage = os.wait4(pid, 0)
            return ProcessExit(os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024)
        ended = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if ended is not None:
            return ProcessExit(ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status, 0)
    return ProcessExit(RUNNING, 0)


if __name__ == "__main__":
    # Import the module under its own name: as `__main__` its classes would differ from those that are unpickled.
    from dynident_service.jobs import fork_server

    fork_server.main()
