#!/usr/bin/env python3
"""Say whether what is installed are the lowest versions that pyproject.toml allows.

.ci/lowest.py            with the Python of the environment in question
"""

from __future__ import annotations

import re
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"
TRIED = ("science", "formats", "service", "postgresql", "otel", "mcp", "test")


def main() -> None:
    """Name every package that is another version than its bound."""
    bounds = lower_bounds(PROJECT.read_text(encoding="utf-8"))
    others = [f"{name}: {version(name)}, not {bound}" for name, bound in bounds.items() if not is_lowest(name, bound)]
    if others:
        sys.exit("these are not the lowest versions that pyproject.toml allows:\n  " + "\n  ".join(others))
    print(f"the lowest versions of {len(bounds)} packages")


def lower_bounds(text: str) -> dict[str, str]:
    """The bound of every package that a user or a test needs."""
    project = tomllib.loads(text)["project"]
    wanted = [*project["dependencies"], *(one for extra in TRIED for one in project["optional-dependencies"][extra])]
    found = (
        re.fullmatch(r"([\w-]+)(?:\[[\w,]+\])?>=([\d.]+)", one) for one in wanted if not one.startswith("dynident[")
    )
    return {one[1]: one[2] for one in found if one is not None}


def is_lowest(name: str, bound: str) -> bool:
    """Whether the installed version is the bound: 3.7 is 3.7.0, and 3.7.1 where there was no 3.7.0."""
    stated, there = ([int(part) for part in re.findall(r"\d+", text)] for text in (bound, version(name)))
    return there[: len(stated)] == stated


if __name__ == "__main__":
    main()
