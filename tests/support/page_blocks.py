"""Code blocks of the pages of the documentation."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

MARK = re.compile(r"<!-- not run: \S.+ -->\n\Z")


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, its text, and whether the page says why it is not run."""

    language: str
    text: str
    marked: bool


def blocks_of(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    found = re.finditer(r"^```(\w*)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
    return [Block(one[1], one[2], bool(MARK.search(text[: one.start()]))) for one in found]


def commands(block: str) -> list[str]:
    """Its commands, one a line, without comments and continued lines joined."""
    lines = re.sub(r"\\\n\s*", "", block).splitlines()
    return [re.sub(r"\s+# .*", "", line) for line in lines if line.strip()]
