"""The page of a report as a tree. Drawings stay text: parsers of HTML spell their elements in small letters."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser

_DRAWING = re.compile(r"<svg\b.*?</svg>", re.DOTALL)
_PLACE = "drawing"
_VOID = frozenset({"br", "hr", "img", "link", "meta", _PLACE})


@dataclass(eq=False)
class Element:
    """One element: its name, attributes, and what is in it, elements and texts.

    One named `svg` has nothing in it, and its own text as `source`.
    """

    name: str
    attributes: dict[str, str] = field(default_factory=dict)
    children: list[Element | str] = field(default_factory=list)
    source: str = ""

    @property
    def classes(self) -> frozenset[str]:
        """The classes that its style goes by."""
        return frozenset(self.attributes.get("class", "").split())

    def all(self, *names: str) -> Iterator[Element]:
        """All elements of these names in it, in the order of the page; none inside of another of them."""
        for child in self.children:
            if isinstance(child, Element):
                if child.name in names:
                    yield child
                else:
                    yield from child.all(*names)

    def first(self, *names: str) -> Element | None:
        """The first of them, if any."""
        return next(self.all(*names), None)


def parsed(page: str) -> Element:
    """The tree of a page: an element without name that holds all others."""
    drawings: list[str] = []

    def place(found: re.Match[str]) -> str:
        drawings.append(found[0])
        return f"<{_PLACE} id={len(drawings) - 1}>"

    builder = _Builder(drawings)
    builder.feed(_DRAWING.sub(place, page))
    builder.close()
    return builder.root


class _Builder(HTMLParser):
    def __init__(self, drawings: list[str]) -> None:
        super().__init__()
        self._drawings = drawings
        self.root = Element("")
        self._open = [self.root]

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = {name: value or "" for name, value in attrs}
        if tag == _PLACE:
            source = self._drawings[int(values["id"])]
            kinds = re.search(r'^<svg[^>]* class="([^"]*)"', source)
            element = Element("svg", {"class": kinds[1] if kinds else ""}, source=source)
        else:
            element = Element(tag, values)
        self._open[-1].children.append(element)
        if tag not in _VOID:
            self._open.append(element)

    def handle_endtag(self, tag: str) -> None:
        if tag in (one.name for one in self._open):
            while self._open.pop().name != tag:
                pass

    def handle_data(self, data: str) -> None:
        self._open[-1].children.append(data)
