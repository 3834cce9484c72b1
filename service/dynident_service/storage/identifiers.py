"""Identifiers of resources and jobs: the kind, then the time, then chance; so they sort by age."""

from __future__ import annotations

import secrets
import threading
import time

ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"
PREFIXES = {
    "robot": "rob",
    "measurement": "mea",
    "design": "des",
    "identification": "idn",
    "comparison": "cmp",
    "diagnosis": "dia",
    "validation": "val",
    "drive_gains": "gai",
    "current_models": "cur",
    "simulation": "sim",
    "report": "rep",
    "series": "ser",
    "import": "imp",
    "batch": "bat",
    "job": "job",
}
KINDS = {prefix: kind for kind, prefix in PREFIXES.items()}


class _Clock:
    """Numbers of 128 bits that grow: 48 bits of time in milliseconds, 80 of chance.

    Within one millisecond (or behind a clock that was set back) a number is the last one and a random step
    more. So what one process makes is listed, and what it queues is begun, in the order in which it was made.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = 0

    def tick(self) -> int:
        fresh = (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80)
        with self._lock:
            # The step is 64 bits of chance: nobody guesses the next identifier from the last.
            behind = fresh >> 80 <= self._last >> 80
            self._last = self._last + 1 + secrets.randbits(64) if behind else fresh
            return self._last


_CLOCK = _Clock()


def new_identifier(kind: str) -> str:
    """Make an identifier: 48 bits of time in milliseconds and 80 of chance, in Crockford's base 32."""
    number = _CLOCK.tick()
    digits = [ALPHABET[number >> shift & 31] for shift in range(125, -1, -5)]
    return f"{PREFIXES[kind]}_{''.join(digits)}"
