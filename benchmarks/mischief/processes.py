"""Processes that are killed and stopped, and started again by whoever looks after them."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import psutil

NURSERY = "dynident_service.jobs.fork_server_main"
PAUSE = 1.0
"""Seconds from the end of a process to its next start."""
LOOK = 0.1


class Kept:
    """A process that is started again when it has ended, as `restart: unless-stopped` of a compose file does."""

    def __init__(self, name: str, folder: Path, command: Sequence[str], environment: dict[str, str]) -> None:
        self.name = name
        self.starts = 0
        self._folder = folder
        self._log = folder / f"{name}.log"
        self._command = command
        self._environment = {**os.environ, **environment}
        self._ended_at: float | None = None
        self._start()

    @property
    def pid(self) -> int:
        """Its number, since it was last started."""
        return self._process.pid

    def look_after(self) -> None:
        """Start it again where it ended a while ago."""
        if self._process.poll() is None:
            return
        moment = time.monotonic()
        self._ended_at = self._ended_at or moment
        if moment - self._ended_at >= PAUSE:
            self._start()

    def kill(self) -> None:
        """End it without a word, and wait until it was started again."""
        before = self.starts
        self._process.kill()
        while self.starts == before:
            time.sleep(LOOK)

    def stop(self, seconds: float) -> None:
        """Let it stand still for a while, as a machine that swaps, or a virtual one that is moved."""
        process = self._process
        process.send_signal(signal.SIGSTOP)
        time.sleep(seconds)
        process.send_signal(signal.SIGCONT)

    def kill_computation(self, chance: random.Random) -> bool:
        """Kill one of the processes that compute; tells whether there was one."""
        return _strike([child for nursery in self._nurseries() for child in _children(nursery)], chance)

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

    def _start(self) -> None:
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                self._command, env=self._environment, cwd=self._folder, stdout=log, stderr=log
            )
        self._ended_at = None
        self.starts += 1

    def _nurseries(self) -> list[psutil.Process]:
        found = []
        with suppress(psutil.Error):
            for child in _children(psutil.Process(self._process.pid)):
                with suppress(psutil.Error):
                    if NURSERY in child.cmdline():
                        found.append(child)
        return found


class Caretaker:
    """Looks after processes, until it is told to leave."""

    def __init__(self, kept: Sequence[Kept]) -> None:
        self._kept = kept
        self._leaves = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)
        self._thread.start()

    def _look(self) -> None:
        while not self._leaves.wait(LOOK):
            for one in self._kept:
                one.look_after()

    def leave(self) -> None:
        """What ends from now on is not started again."""
        self._leaves.set()
        self._thread.join()


def _children(process: psutil.Process) -> list[psutil.Process]:
    with suppress(psutil.Error):
        return process.children()
    return []


def _strike(processes: list[psutil.Process], chance: random.Random) -> bool:
    if not processes:
        return False
    with suppress(psutil.Error):
        chance.choice(processes).kill()
    return True
