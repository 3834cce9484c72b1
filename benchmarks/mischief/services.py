"""Services on one database, each a process that can be killed, stopped, and started again."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil
from service_beside import free_port

NURSERY = "dynident_service.jobs.nursery"
JOBS = Path(__file__).resolve().parents[2] / "tests" / "service"
"""Where the small jobs of the tests are."""


class Service:
    """One process that answers requests and does jobs; whoever looks after it starts it again when it has ended."""

    def __init__(self, name: str, folder: Path, url: str) -> None:
        self.name = name
        self.port = free_port()
        self.starts = 0
        self._log = folder / f"{name}.log"
        paths = [str(JOBS), *filter(None, [os.environ.get("PYTHONPATH")])]
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(paths),
            "DYNIDENT_DATA_DIR": str(folder / "data"),
            "DYNIDENT_DATABASE_URL": url,
            "DYNIDENT_PORT": str(self.port),
            "DYNIDENT_WORKERS": "2",
            "DYNIDENT_LOG_LEVEL": "warning",
            "DYNIDENT_LOG_FORMAT": "json",
        }
        self.start()

    def start(self) -> None:
        """Start it."""
        with self._log.open("ab") as log:
            command = [sys.executable, "-m", "dynident_service"]
            self._process = subprocess.Popen(command, env=self._environment, stdout=log, stderr=log)
        self.starts += 1

    def look_after(self) -> None:
        """Start it again where it has ended."""
        if self._process.poll() is not None:
            self.start()

    def kill(self) -> None:
        """End it without a word, and start it again a second later."""
        self._process.kill()
        self._process.wait()
        time.sleep(1.0)
        self.start()

    def stop(self, seconds: float) -> None:
        """Let it stand still for a while, as a machine that swaps, or a virtual one that is moved."""
        self._process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        self._process.send_signal(signal.SIGCONT)

    def kill_computation(self, chance: random.Random) -> bool:
        """Kill one of the processes that compute; tells whether there was one."""
        return _strike([child for nursery in self._nurseries() for child in nursery.children()], chance)

    def kill_nursery(self, chance: random.Random) -> bool:
        """Kill the process that these are forked from."""
        return _strike(self._nurseries(), chance)

    def log_lines(self) -> list[str]:
        """What it has written into its log."""
        return self._log.read_text(errors="replace").splitlines()

    def end(self) -> None:
        """End it for good."""
        self._process.kill()
        self._process.wait()

    def _nurseries(self) -> list[psutil.Process]:
        found = []
        with suppress(psutil.Error):
            for child in psutil.Process(self._process.pid).children():
                with suppress(psutil.Error):
                    if NURSERY in child.cmdline():
                        found.append(child)
        return found


def _strike(processes: list[psutil.Process], chance: random.Random) -> bool:
    if not processes:
        return False
    with suppress(psutil.Error):
        chance.choice(processes).kill()
    return True
