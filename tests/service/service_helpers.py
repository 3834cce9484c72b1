"""What several tests of the service use."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

TWO_JOINTS = {
    "joints": [
        {"name": "shoulder", "alpha": 0, "d": 0, "r": 0},
        {"name": "elbow", "alpha": 0, "d": 0.5, "r": 0},
    ]
}


def wait_for(condition: Callable[[], Any], timeout: float = 30.0) -> Any:
    end = time.monotonic() + timeout
    while time.monotonic() < end:
        if found := condition():
            return found
        time.sleep(0.01)
    raise AssertionError(f"not within {timeout} s")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
