"""Jobs that do next to nothing, for the tests of the engine (imported by name in child processes)."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from pathlib import Path

from dynident.errors import DynidentError
from dynident_service.jobs.work import Outcome, Task


def answer(task: Task) -> Outcome:
    return Outcome({"answer": task.arguments.get("answer", 42)})


def count(task: Task) -> Outcome:
    steps = int(task.arguments["steps"])
    for step in range(steps):
        task.progress((step + 1) / steps, f"step {step + 1}")
        time.sleep(float(task.arguments.get("pause", 0.12)))
    return Outcome({"steps": steps})


def stubborn(task: Task) -> Outcome:
    """Hold the interpreter lock and start a process of its own, as a solver might."""
    grandchild = subprocess.Popen(["sleep", "600"])
    Path(task.arguments["note"]).write_text(f"{os.getpid()} {grandchild.pid}")
    sum(range(10**11))
    return Outcome()


def wrong(task: Task) -> Outcome:
    raise DynidentError("q3 has a gap of 2.5 s at t = 10 s; cut it with windows", pointer="q3", title="Gap in time")


def broken(task: Task) -> Outcome:
    raise RuntimeError("secret of the machine room")


def dies(task: Task) -> Outcome:
    """Die as if out of memory, as often as is asked; then succeed."""
    note = Path(task.arguments["note"])
    deaths = int(note.read_text()) if note.exists() else 0
    if deaths < int(task.arguments["times"]):
        note.write_text(str(deaths + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return Outcome({"deaths": deaths})
