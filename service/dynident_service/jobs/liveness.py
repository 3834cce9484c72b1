"""Detection of hanging processes, by their heartbeat or by the processor time that they use."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Literal

TICKS = os.sysconf("SC_CLK_TCK")
LEAST = 0.005
"""Smallest share of a processor that a computation gets, even on a busy machine; a thread that only waits for the
interpreter uses a tenth of it.
"""
PROCESSES = Path("/proc")
"""Linux's folder with the state of all processes."""
Condition = Literal["alive", "stopped", "still"]


class ActivityMonitor:
    """Watch over one process group.

    A thread inside the computation sends heartbeats, but a solver may hold the interpreter for minutes; then the
    processor time of the group decides. If neither advances, the process was stopped from outside or hangs.
    """

    def __init__(self, patience: float) -> None:
        self._patience = patience
        self._since = time.monotonic()
        self._heartbeats = 0
        self._used = 0

    def check_activity(self, pid: int, heartbeats: int) -> Condition:
        """Return the condition of the group that a process leads."""
        elapsed = time.monotonic() - self._since
        if heartbeats == self._heartbeats and elapsed < self._patience:
            return "alive"
        used, state = measure_group(pid)
        # A process that waits for a disk (state D) is no hanging one. Without /proc the state is unknown, and the
        # process gets the benefit of the doubt.
        computes = used - self._used >= max(2.0, LEAST * elapsed * TICKS) or state in ("D", "")
        if heartbeats != self._heartbeats or computes:
            self._since, self._heartbeats, self._used = time.monotonic(), heartbeats, used
            return "alive"
        return "stopped" if state in ("T", "t") else "still"


def measure_processor_time(pid: int) -> float:
    """Return the processor time of a process in seconds, or 0 if it is unknown."""
    try:
        # The name of the program stands in parentheses and may hold spaces, so fields are counted from the last
        # parenthesis.
        fields = (PROCESSES / str(pid) / "stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS


def measure_group(leader: int) -> tuple[int, str]:
    """Return the processor time of a process group in ticks and the state of its leader, or "" if it is unknown."""
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
