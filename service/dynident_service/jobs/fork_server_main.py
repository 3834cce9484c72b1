"""Main program of the fork server, and the modules that it imports ahead.

It is single-threaded (except for Arrow's own thread, which Arrow handles at a fork) and does nothing else: it forks on
request and reports how a child ended. `pool` starts it and talks to it.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import signal
import socket
import sys
import warnings

from dynident_service.environment_secrets import take_secrets
from dynident_service.jobs import child_process
from dynident_service.jobs.child_pool import FORK, MESSAGE, REAP, RUNNING, ProcessExit, receive_exactly
from dynident_service.settings import LogSettings
from dynident_service.tracing import configure_logging

PRELOADED = tuple(
    f"dynident_service.{resource}.jobs"
    for resource in (
        "campaigns",
        "comparisons",
        "designs",
        "diagnoses",
        "drive_gains",
        "identifications",
        "measurements",
        "reports",
        "robots",
        "validations",
    )
)
"""Modules that are imported before the first fork: what child processes compute."""


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
            child_process.serve_jobs(*fds)
            os._exit(0)
        for fd in fds:
            os.close(fd)


def _receive(control: socket.socket) -> tuple[bytes, list[int]]:
    received, fds, _, _ = socket.recv_fds(control, MESSAGE.size, 2)
    if not received:
        raise ConnectionError("the other end is closed")
    return received + receive_exactly(control, MESSAGE.size - len(received)), list(fds)


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
    main()
