"""What recordings are called after the files that they come from."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def unique_names(paths: Iterable[Path]) -> list[str]:
    """A name for every file: its stem, with a number behind it where two files share one."""
    names: list[str] = []
    for path in paths:
        name, count = path.stem, 2
        while name in names:
            name, count = f"{path.stem}_{count}", count + 1
        names.append(name)
    return names
