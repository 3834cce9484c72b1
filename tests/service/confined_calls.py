"""What a library might do that a hostile file leads astray (called by name in child processes)."""

from __future__ import annotations

import os
import signal
import socket
import tempfile
import time
from pathlib import Path

import numpy as np

from dynident_service.jobs.task_input_output import Outcome, Task


def read_file(path: str) -> str:
    return Path(path).read_text()


def list_folder(path: str) -> list[str]:
    return sorted(entry.name for entry in Path(path).iterdir())


def write_file(path: str, size: int) -> int:
    return Path(path).write_bytes(bytes(size))


def connect(port: int) -> str:
    with socket.create_connection(("127.0.0.1", port), timeout=2):
        return "connected"


def allocate(size: int) -> int:
    return int(np.ones(size // 8).sum())


def compute(seconds: float) -> str:
    """Compute in Python, which gives signs of life."""
    until = time.process_time() + seconds
    while time.process_time() < until:
        sum(range(1000))
    return "done"


def go_round_in_circles() -> None:
    """Hold the interpreter for good, as a library does in a cycle of a damaged file."""
    sum(range(10**12))


def take_memory(task: Task) -> Outcome:
    """Take memory as a job; be killed then where `is_killed`, as by a system that has none left."""
    block = np.ones(int(task.arguments["size"]) // 8)
    if task.arguments["is_killed"]:
        os.kill(os.getpid(), signal.SIGKILL)
    return Outcome({"sum": float(block.sum())})


def list_descriptors() -> list[int]:
    return sorted(fd for fd in range(256) if _is_open(fd))


def temporary_folder() -> str:
    with tempfile.NamedTemporaryFile() as file:
        return str(Path(file.name).parent)


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True
