"""Whether a process that works on a job is alive: by its heartbeat, or by the processor time that it uses."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Literal

TICKS = os.sysconf("SC_CLK_TCK")
LEAST = 0.005
"""The share of a processor that a computation gets at least, even beside much other work; a thread that only waits for
the interpreter uses a tenth of it."""
PROCESSES = Path("/proc")
Condition = Literal["alive", "stopped", "still"]


class Vitals:
    """Watches one process group.

    A thread inside the computation sends a heartbeat, but a solver may hold the interpreter for minutes: then the
    processor time of the group tells. Where neither moves, the process is stopped from outside or stands still.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._since = time.monotonic()
        self._heartbeats = 0
        self._used = 0

    def look(self, pid: int, heartbeats: int) -> Condition:
        """Look at the group that a process leads."""
        elapsed = time.monotonic() - self._since
        if heartbeats == self._heartbeats and elapsed < self._patience:
            return "alive"
        used, state = group_of(pid)
        # Who waits for a disk does what it can; where there is no /proc, nothing is known.
        computes = used - self._used >= max(2.0, LEAST * elapsed * TICKS) or state in ("D", "")
        if heartbeats != self._heartbeats or computes:
            self._since, self._heartbeats, self._used = time.monotonic(), heartbeats, used
            return "alive"
        return "stopped" if state in ("T", "t") else "still"


def processor_time(pid: int) -> float:
    """Processor time of a process in seconds; 0 where it is not known."""
    try:
        fields = (PROCESSES / str(pid) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS


def group_of(leader: int) -> tuple[int, str]:
    """The processor time of a process group, in ticks, and the state of its leader; "" where it is not known."""
    used, state = 0, ""
    for path in PROCESSES.glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue  # it has ended meanwhile
        if int(fields[2]) == leader:
            used += int(fields[11]) + int(fields[12])
        if path.parent.name == str(leader):
            state = fields[0]
    return used, state
