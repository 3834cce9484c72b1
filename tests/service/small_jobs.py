"""Jobs that do next to nothing, for the tests of the engine (imported by name in child processes)."""

from __future__ import annotations

import ctypes
import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from obstore.exceptions import PermissionDeniedError
from sqlalchemy.exc import OperationalError

from dynident.errors import DynidentError
from dynident_service.jobs.task_input_output import Outcome, Task
from dynident_service.storage.job_queue import JobQueue


def answer(task: Task) -> Outcome:
    return Outcome({"answer": task.arguments.get("answer", 42)})


def stands_back(task: Task) -> Outcome:
    """Say how far it stands back behind other processes."""
    Path(task.arguments["note"]).write_text(str(os.getpriority(os.PRIO_PROCESS, 0)))
    return Outcome()


def count(task: Task) -> Outcome:
    steps = int(task.arguments["steps"])
    for step in range(steps):
        task.progress((step + 1) / steps, f"step {step + 1}")
        time.sleep(float(task.arguments.get("pause", 0.12)))
    return Outcome({"steps": steps})


def counts_and_tells_the_time(task: Task) -> Outcome:
    counted = count(task)
    Path(task.arguments["note"]).write_text(str(time.time()))
    return counted


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


def waits(task: Task) -> Outcome:
    """Say who does it, then wait for a file."""
    Path(task.arguments["note"]).write_text(str(os.getpid()))
    while not Path(task.arguments["go"]).exists():
        time.sleep(0.02)
    return Outcome()


def keeps(task: Task) -> Outcome:
    """The same, then keep so many bytes."""
    waits(task)
    return Outcome(objects=(task.store_file("log", os.urandom(int(task.arguments["size"]))),))


def stands_still(task: Task) -> Outcome:
    """Hold the interpreter lock and do nothing, as a computation that waits for itself."""
    ctypes.PyDLL(None).sleep(600)
    return Outcome()


def holds_the_interpreter(task: Task) -> Outcome:
    """Compute for some seconds as a solver does, without a word."""
    sum(range(int(task.arguments["numbers"])))
    return Outcome()


def meets_a_hiccup(task: Task) -> Outcome:
    """Find the database away for a moment when progress is reported and when the result is stored."""
    for name in ("record_progress", "record_success"):
        setattr(JobQueue, name, _failing_at_first(name, getattr(JobQueue, name), int(task.arguments["times"])))
    time.sleep(0.15)
    task.progress(0.5, "half of it")
    return Outcome({"answer": 42})


def loses_the_database(task: Task) -> Outcome:
    """Find the database away when something is to be read, the first time."""
    note = Path(task.arguments["note"])
    if not note.exists():
        note.write_text("lost")
        raise OperationalError("SELECT", {}, Exception("server closed the connection unexpectedly"))
    return Outcome()


def meets_a_store_that_refuses(task: Task) -> Outcome:
    raise PermissionDeniedError("403 Forbidden: the key has expired")


def niceness() -> int:
    """Say how far a computation that a request waits for stands back."""
    return os.getpriority(os.PRIO_PROCESS, 0)


def twice(number: int) -> int:
    """A call, not a job."""
    return 2 * number


def never_answers(note: str) -> None:
    Path(note).write_text(str(os.getpid()))
    sum(range(10**11))


def dies_at_once() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def crashes() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def refuses() -> None:
    raise DynidentError("q3 has a gap", pointer="q3", title="Gap in time")


def fills_the_disk(task: Task) -> Outcome:
    raise OSError(errno.ENOSPC, "No space left on device")


def _failing_at_first(name: str, method: Any, times: int) -> Any:
    left = [times]

    def failing(*arguments: Any) -> Any:
        if left[0] == 0:
            setattr(JobQueue, name, method)
            return method(*arguments)
        left[0] -= 1
        raise OperationalError("UPDATE", {}, Exception("database is locked"))

    return failing


def goes_on(task: Task) -> Outcome:
    """Keep what was reached, die once in the middle, and tell where the last attempt began."""
    began = int(task.checkpoints.load_last() or b"0")
    Path(task.arguments["note"]).write_text(str(began))
    for step in range(began, 10):
        vars(task.checkpoints)["_next"] = 0.0  # at once, not after some seconds
        task.checkpoints.save(lambda step=step: b"%d" % step)
        if step == 6 and began == 0:
            os.kill(os.getpid(), signal.SIGKILL)
    return Outcome()


def read_as_it_says(kind: str, request: dict[str, Any], result: dict[str, Any], files: dict[str, str]) -> str | None:
    if request["it"] == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if request["it"] == "hangs":
        time.sleep(60)
    return None


def variables(names: list[str]) -> dict[str, str | None]:
    """The environment that a child sees, and what it can read from its standard input."""
    return {**{name: os.environ.get(name) for name in names}, "standard input": sys.stdin.read()}
