"""Identifiers of resources and jobs: prefix of the kind, time and random bits, so that they sort by age."""

from __future__ import annotations

import secrets
import threading
import time

ALPHABET = "0123456789abcdefghjkmnpqrstvwxyz"
"""Crockford's base 32: no letters that are easily confused, and in the order of ASCII."""
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


class _NumberSequence:
    """Source of increasing 128-bit numbers: 48 bits of time in milliseconds, 80 random bits.

    Within one millisecond, or after the clock was set back, a number is the previous one plus a random step. Lists and
    queues therefore keep the order in which one process created their entries.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._last = 0

    def draw_number(self) -> int:
        fresh = (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80)
        with self._lock:
            # The step is 64 bits of chance: nobody guesses the next identifier from the last.
            # `behind` also covers a clock that was set back.
            behind = fresh >> 80 <= self._last >> 80
            self._last = self._last + 1 + secrets.randbits(64) if behind else fresh
            return self._last


_CLOCK = _NumberSequence()


def create_identifier(kind: str) -> str:
    """Return a new identifier: the prefix of its kind and a 128-bit number in Crockford's base 32.

    Parameters
    ----------
    kind : str
        Key of `PREFIXES`.
    """
    number = _CLOCK.draw_number()
    # 26 digits of 5 bits are 130 bits; the first digit holds only the upper 3 of the 128.
    digits = [ALPHABET[number >> shift & 31] for shift in range(125, -1, -5)]
    return f"{PREFIXES[kind]}_{''.join(digits)}"
