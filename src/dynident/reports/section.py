"""The sections of which a report consists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True, eq=False)
class Section:
    """One section of a report: a template and the content that fills it.

    Attributes
    ----------
    anchor : str
        The target of links in the table of contents.
    title : str
        Heading of the section.
    template : str
        File name of the template without its ending.
    content : object
        What the template sees under the name `it`.
    """

    anchor: str
    title: str
    template: str
    content: Any
