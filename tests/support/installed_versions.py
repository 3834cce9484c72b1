"""Versions that what is installed is compared with: some of what tests hold is of the newer ones alone."""

from __future__ import annotations

import re
import tomllib
from functools import cache
from importlib.metadata import version
from pathlib import Path

LOCK = Path(__file__).resolve().parents[2] / "uv.lock"


def older_than_locked(name: str) -> bool:
    """Whether a package is older than that of the lock file."""
    return _numbers(version(name)) < _numbers(_locked()[name])


@cache
def _locked() -> dict[str, str]:
    packages = tomllib.loads(LOCK.read_text(encoding="utf-8"))["package"]
    return {one["name"]: one["version"] for one in packages if "version" in one}


def _numbers(text: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", text)[:3])
