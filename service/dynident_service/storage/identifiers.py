"""Identifiers of resources and jobs: the kind, then the time, then chance; so they sort by age."""

from __future__ import annotations

import secrets
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


def new_identifier(kind: str) -> str:
    """Make an identifier: 48 bits of time in milliseconds and 80 random bits, in Crockford's base 32."""
    number = (time.time_ns() // 1_000_000) << 80 | secrets.randbits(80)
    digits = [ALPHABET[number >> shift & 31] for shift in range(125, -1, -5)]
    return f"{PREFIXES[kind]}_{''.join(digits)}"
