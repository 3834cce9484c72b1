"""The process that child processes are forked from: it has loaded the science once, so a new child is there at once.

It is single-threaded (but for Arrow's own thread, which Arrow looks after when forking) and does nothing else: it
forks when it is asked to, and says how a child ended.
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

from dynident_service.environment import environment_for_children, secrets_for_children, take_secrets
from dynident_service.jobs import child
from dynident_service.logs import configure
from dynident_service.settings import LogSettings

PRELOADED = ("dynident_service.work", "dynident_service.work.awaited")
ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
BOUNDED_ARROW = {"ARROW_DEFAULT_MEMORY_POOL": "system"}
"""Arrow's own allocator reserves 1 GB of addresses at once, which the limits of children would count."""
MESSAGE = struct.Struct("!iiq")
FORK, REAP, LOOK = 1, 2, 3
RUNNING = 1 << 20
"""Stands for an exit code while there is none."""


class Exit(NamedTuple):
    """How a process ended: its exit code, negative for a signal, and the most memory in bytes that it had."""

    code: int
    peak_memory: int


class Nursery:
    """Starts the process, and asks it for children."""

    PROGRAM: ClassVar[Sequence[str]] = ("-m", "dynident_service.jobs.nursery")
    """What Python is told to run: `main`, whatever was done before it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None

    def fork(self, jobs: int, lifeline: int) -> None:
        """Ask for a child that works on the pipe `jobs`; it appears once the science is loaded."""
        with self._lock:
            try:
                self._send_fork(jobs, lifeline)
            except OSError:  # it has died: begin with a new one
                self._stop()
                self._send_fork(jobs, lifeline)

    def exit_of(self, pid: int, *, reap: bool) -> Exit | None:
        """Tell how a child ended; `None` if it runs, or its nursery has died.

        With `reap` it is waited for, and its number may be given to another process; its memory is known then alone.
        """
        with self._lock:
            if self._control is None:
                return None
            try:
                self._control.sendall(MESSAGE.pack(REAP if reap else LOOK, pid, 0))
                _, code, peak_memory = MESSAGE.unpack(_exactly(self._control))
            except OSError:
                return None
        return None if code == RUNNING else Exit(code, peak_memory)

    def close(self) -> None:
        """End the process."""
        with self._lock:
            self._stop()

    def _send_fork(self, jobs: int, lifeline: int) -> None:
        control = self._control or self._start()
        socket.send_fds(control, [MESSAGE.pack(FORK, 0, 0)], [jobs, lifeline])

    def _start(self) -> socket.socket:
        ours, theirs = socket.socketpair()
        with theirs, secrets_for_children() as secrets:
            self._process = subprocess.Popen(
                [sys.executable, *self.PROGRAM, str(theirs.fileno())],
                pass_fds=(theirs.fileno(),),
                stdin=secrets,
                env={**environment_for_children(), **ONE_THREAD, **BOUNDED_ARROW},
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
    """Load the science, then serve until the other end is closed."""
    take_secrets()
    control = socket.socket(fileno=int(sys.argv[1]))
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # what solvers print belongs to the log
    settings = LogSettings()
    configure(settings.log_level, settings.log_format)
    warnings.filterwarnings("ignore", message=".*fork.*", category=DeprecationWarning)
    for module in PRELOADED:
        importlib.import_module(module)
    gc.freeze()  # the collector of a child leaves shared memory alone
    while True:
        try:
            received, fds = _receive(control)
        except OSError:
            return
        kind, pid, _ = MESSAGE.unpack(received)
        if kind != FORK:
            control.sendall(MESSAGE.pack(kind, *_exit_of(pid, reap=kind == REAP)))
        elif os.fork() == 0:
            control.close()
            os.setsid()
            child.work(*fds)
            os._exit(0)
        for fd in fds:
            os.close(fd)


def _receive(control: socket.socket) -> tuple[bytes, list[int]]:
    received, fds, _, _ = socket.recv_fds(control, MESSAGE.size, 2)
    if not received:
        raise ConnectionError("the other end is closed")
    return received + _exactly(control, MESSAGE.size - len(received)), list(fds)


def _exactly(control: socket.socket, size: int = MESSAGE.size) -> bytes:
    content = b""
    while len(content) < size:
        part = control.recv(size - len(content))
        if not part:
            raise ConnectionError("the other end is closed")
        content += part
    return content


def _exit_of(pid: int, *, reap: bool) -> Exit:
    """How a child ended, or RUNNING; without `reap` its number is kept."""
    with contextlib.suppress(ChildProcessError):
        if reap:
            _, status, usage = os.wait4(pid, 0)
            return Exit(os.waitstatus_to_exitcode(status), usage.ru_maxrss * 1024)
        ended = os.waitid(os.P_PID, pid, os.WEXITED | os.WNOHANG | os.WNOWAIT)
        if ended is not None:
            return Exit(ended.si_status if ended.si_code == os.CLD_EXITED else -ended.si_status, 0)
    return Exit(RUNNING, 0)


if __name__ == "__main__":
    # Under its own name, so that what is unpickled is of the same classes.
    from dynident_service.jobs import nursery

    nursery.main()
