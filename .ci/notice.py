#!/usr/bin/env python3
"""Write NOTICE: what is installed beside dynident[service,postgresql], and under which licences.

.ci/notice.py            with the Python of an environment that has dynident[service,postgresql]
"""

from __future__ import annotations

import re
import tomllib
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
HEAD = """dynident
Copyright the dynident maintainers. Licensed under the Apache License, Version 2.0: see LICENSE.

The wheel of dynident holds no program of others. What `pip install 'dynident[service,postgresql]'` and the container
image install beside it, on Linux, is listed here with the licence that each states of itself. This list is made by
.ci/notice.py.

CasADi and psycopg are under the LGPL: they are used as they are, as libraries that may be exchanged.
"""
# Packages that state no licence in their metadata, and what their sources say.
UNSTATED = {"cmeel-qhull": "Qhull (its own permissive licence, COPYING.txt); stated by no metadata of the package"}


def main() -> None:
    """Write the file."""
    lines = [f"{name}  {licence_of(name)}" for name in sorted(installed_beside())]
    (ROOT / "NOTICE").write_text(HEAD + "\n" + "\n".join(lines) + "\n", encoding="utf-8")
    print(f"NOTICE: {len(lines)} packages")


def installed_beside() -> set[str]:
    """Names of the packages of the lock file that [service,postgresql] comes with on Linux, ours left out."""
    packages: dict[str, list[dict[str, Any]]] = {}
    for one in tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))["package"]:
        packages.setdefault(one["name"], []).append(one)
    ours = packages["dynident"][0]
    extras = ours["optional-dependencies"]
    waiting = [*ours["dependencies"], *extras["service"], *extras["postgresql"]]
    found: set[str] = set()
    while waiting:
        entry = waiting.pop()
        if entry["name"] in found or not on_linux(entry.get("marker", "")):
            continue
        found.add(entry["name"])
        for package in packages[entry["name"]]:
            waiting += package.get("dependencies", [])
            for extra in entry.get("extra", []):
                waiting += package.get("optional-dependencies", {}).get(extra, [])
    return found - {"dynident"}


def on_linux(marker: str) -> bool:
    """Whether a dependency with this marker is one on Linux, by CPython."""
    return not re.search(r"sys_platform == '(win32|emscripten)'|platform_system == 'Windows'|< '3.1[01]'|PyPy'", marker)


def licence_of(name: str) -> str:
    """The licence that a package states, in one line."""
    try:
        stated = _stated(distribution(name))
    except PackageNotFoundError:
        return "not installed here: see its page on pypi.org"
    return UNSTATED.get(name, stated or "not stated: see its page on pypi.org")


def _stated(package: Distribution) -> str:
    expression = package.metadata.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = package.metadata.get_all("Classifier") or []
    classified = [text.rpartition(" :: ")[2] for text in classifiers if text.startswith("License ::")]
    classified = [text for text in classified if text != "OSI Approved"]
    first = (package.metadata.get("License") or "").strip().splitlines()
    return "; ".join(classified) or (first[0].strip() if first else "")


if __name__ == "__main__":
    main()
