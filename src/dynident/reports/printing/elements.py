"""The HTML page of a report as a tree of elements.

Drawings stay text, since parsers of HTML turn the names of SVG elements into small letters.
"""

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
    """One element of a page.

    Attributes
    ----------
    name : str
        The name of its tag, "" for the root.
    attributes : dict
    children : list
        Elements and texts, in the order of the page; none in a drawing (`svg`).
    source : str
        The text of a drawing, "" for other elements.
    """

    name: str
    attributes: dict[str, str] = field(default_factory=dict)
    children: list[Element | str] = field(default_factory=list)
    source: str = ""

    @property
    def classes(self) -> frozenset[str]:
        """The CSS classes of the element."""
        return frozenset(self.attributes.get("class", "").split())

    def find_all(self, *names: str) -> Iterator[Element]:
        """Yield all descendants of these names in the order of the page, but none inside of another of them."""
        for child in self.children:
            if isinstance(child, Element):
                if child.name in names:
                    yield child
                else:
                    yield from child.find_all(*names)

    def find_first(self, *names: str) -> Element | None:
        """Return the first of the elements that `all` yields; None where there is none."""
        return next(self.find_all(*names), None)


def parse_page(page: str) -> Element:
    """Parse a page.

    Parameters
    ----------
    page : str
        HTML as `html_report` writes it.

    Returns
    -------
    Element
        A root without a name that holds all others.
    """
    # Each drawing is replaced by an empty element with its number before parsing, and put back by the builder.
    drawings: list[str] = []

    def put_placeholder(drawing: re.Match[str]) -> str:
        drawings.append(drawing[0])
        return f"<{_PLACE} id={len(drawings) - 1}>"

    builder = _Builder(drawings)
    builder.feed(_DRAWING.sub(put_placeholder, page))
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
            style_class = re.search(r'^<svg[^>]* class="([^"]*)"', source)
            element = Element("svg", {"class": style_class[1] if style_class else ""}, source=source)
        else:
            element = Element(tag, values)
        self._open[-1].children.append(element)
        if tag not in _VOID:
            self._open.append(element)

    def handle_endtag(self, tag: str) -> None:
        # Elements whose end tag is missing end with the element around them; an end tag without a start is ignored.
        if tag in (element.name for element in self._open):
            while self._open.pop().name != tag:
                pass

    def handle_data(self, data: str) -> None:
        self._open[-1].children.append(data)
