"""A report is a list of sections; a section is a template and what it is filled with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Section:
    """One section: `anchor` and `title` for the table of contents, `template` (a file's stem), `content` to fill it.

    The template sees `content` under the name `it`.
    """

    anchor: str
    title: str
    template: str
    content: Any
