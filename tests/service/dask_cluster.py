"""A Dask cluster of its own, and a clock that is wrong for one of its workers alone."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from service_helpers import free_port

WRONG_CLOCK = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>

int clock_gettime(clockid_t which, struct timespec *told) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *))dlsym(RTLD_NEXT, "clock_gettime");
    int failed = real(which, told);
    const char *off = getenv("SECONDS_OFF");
    if (!failed && off && (which == CLOCK_REALTIME || which == CLOCK_REALTIME_COARSE)) told->tv_sec += atol(off);
    return failed;
}
"""


PRELOADED = Path(__file__).parent
SCIENCE, SMALL_JOBS = PRELOADED / "worker_of_tests.py", PRELOADED / "worker_without_science.py"
"""What the workers of a cluster load before they begin: for jobs that need the science, and for small ones."""


class Cluster:
    """A scheduler and a worker, or more that are started, as processes of their own."""

    def __init__(self, folder: Path, preloaded: Path = SMALL_JOBS) -> None:
        self._folder = folder
        self._preloaded = str(preloaded)
        self._port = free_port()
        self._workers: list[subprocess.Popen[bytes]] = []
        self.address = f"tcp://127.0.0.1:{self._port}"
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(self._port))
        self.worker = self.new_worker()

    def new_worker(self, **more: str) -> subprocess.Popen[bytes]:
        """Start a worker, with more in its environment."""
        given = ("--nthreads", "1", "--no-nanny", "--preload", self._preloaded)
        self.worker = self._start("dask_worker", self.address, *given, **more)
        self._workers.append(self.worker)
        return self.worker

    def new_scheduler(self) -> None:
        self.scheduler = self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(self._port))

    def end(self) -> None:
        for process in (*self._workers, self.scheduler):
            process.kill()
            process.wait()

    def _start(self, program: str, *arguments: str, **more: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.{program}", *arguments, "--dashboard-address", "127.0.0.1:0"]
        environment = {**os.environ, "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error", **more}
        quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        return subprocess.Popen(command, cwd=self._folder, env=environment, **quiet)


def wrong_clock(folder: Path, seconds: int) -> dict[str, str]:
    """The environment of a process whose clock is wrong by so much; skips where it cannot be made."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("a C compiler on Linux is needed to give one process another clock")
    source, library = folder / "wrong_clock.c", folder / "wrong_clock.so"
    source.write_text(WRONG_CLOCK)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    return {"LD_PRELOAD": str(library), "SECONDS_OFF": str(seconds)}
