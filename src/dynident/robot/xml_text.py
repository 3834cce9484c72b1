"""Read XML safely with line numbers (limits on size and depth), and write it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from dynident.errors import DynidentError
from dynident.robot.json_fields import check_unicode
from dynident.text_encoding import NOT_XML

MOST_ELEMENTS = 100_000
"""Most elements of a text, visual ones included: a robot of 2000 links has about 50 000."""
DEEPEST = 100
"""Deepest nesting of elements; a URDF needs six."""
_PART_BYTES = 2**16


@dataclass(frozen=True)
class Element:
    """An XML element.

    Parameters
    ----------
    tag : str
        Its name.
    attributes : dict of str to str
        Its attributes.
    line : int
        The line that it starts on; 0 where it was not read.
    children : list of Element
        Its children; text between them is not kept.
    """

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)

    def iter_children(self, tag: str) -> Iterator[Element]:
        """Return the children with this tag."""
        return (child for child in self.children if child.tag == tag)

    def find_child(self, tag: str) -> Element | None:
        """Return the first child with this tag; None if there is none."""
        return next(self.iter_children(tag), None)


def parse_xml(text: str, what: str, pointer: str, title: str) -> Element:
    """Return the root element of a text that is not empty.

    Parameters
    ----------
    text : str
        The text.
    what : str
        What the text should be, for messages: "A URDF".
    pointer, title : str
        JSON pointer and title of errors.

    Returns
    -------
    Element
        With its children, and the lines that elements start on.

    Raises
    ------
    DynidentError
        The text is not XML (with line and column), or it has more elements, or more deeply nested ones, than any robot
        needs.
    """
    check_unicode(text, pointer, title)
    # A declaration must be the very first thing in XML. Blank lines before it are cut off, but counted.
    first_line = 1 + text[: len(text) - len(text.lstrip())].count("\n")
    text = text.strip().removeprefix("\ufeff")

    def fail(detail: str, line: int | None) -> DynidentError:
        return DynidentError(f"line {line}: {detail}" if line else detail, pointer=pointer, title=title)

    # An element above the root, so that each element that starts has a parent to be added to.
    document = Element("", {}, 0)
    open_elements = [document]
    count = 0
    parser = expat.ParserCreate("utf-8")  # whatever the declaration says: the text is decoded already

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        line = parser.CurrentLineNumber + first_line - 1
        if count > MOST_ELEMENTS:
            raise fail(f"The text has more than {MOST_ELEMENTS} elements.", line)
        if len(open_elements) > DEEPEST:
            raise fail(f"<{tag}> is nested more than {DEEPEST} levels deep.", line)
        element = Element(tag, attributes, line)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def end(_tag: str) -> None:
        open_elements.pop()

    # A document type can define entities that expand without end, or that read other files.
    def doctype(name: str, *_: object) -> None:
        if name.casefold() == "html":
            page = f"This is a web page, and not {what[0].lower()}{what[1:]}"
            raise fail(f"{page}: download the file itself (on GitHub with the button Raw).", None)
        raise fail(f"{what} must not have a document type declaration; remove <!DOCTYPE …>.", None)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text.encode(), True)
    except expat.ExpatError as error:
        reason = expat.ErrorString(error.code)
        line = error.lineno + first_line - 1
        raise fail(f"The XML is malformed at column {error.offset + 1}: {reason}.", line) from None
    return document.children[0]


def read_root(text: str) -> Element | None:
    """Return the root element without its children; None if the text does not begin as XML."""
    root: list[Element] = []

    def start(tag: str, attributes: dict[str, str]) -> None:
        if not root:
            root.append(Element(tag, attributes, parser.CurrentLineNumber))

    parser = expat.ParserCreate("utf-8")
    parser.StartElementHandler = start
    content = text.strip().encode(errors="replace")
    # Stop at the first element: the text may be large, and only its kind is of interest here.
    try:
        for first in range(0, len(content), _PART_BYTES):
            parser.Parse(content[first : first + _PART_BYTES], False)
            if root:
                break
    except expat.ExpatError:
        pass  # whoever reads the whole text says what is wrong with it
    return root[0] if root else None


def write_xml(element: Element, indent: bool = False, depth: int = 0) -> str:
    """Return the XML text of an element, on one line or indented for people.

    Parameters
    ----------
    element : Element
        The element, with its children.
    indent : bool
        Whether every element has a line of its own.
    depth : int
        How far the element itself is indented.

    Returns
    -------
    str
        XML without a declaration.

    Raises
    ------
    DynidentError
        If a value has control characters, which XML cannot hold.
    """
    margin, end = ("  " * depth, "\n") if indent else ("", "")
    attributes = _write_attributes(element)
    if not element.children:
        return f"{margin}<{element.tag}{attributes}/>{end}"
    inside = "".join(write_xml(child, indent, depth + 1) for child in element.children)
    return f"{margin}<{element.tag}{attributes}>{end}{inside}{margin}</{element.tag}>{end}"


def format_numbers(*values: float) -> str:
    """Return numbers as the text of an attribute, to the last digit."""
    return " ".join(repr(float(value)) for value in values)


def write_with_line_numbers(root: Element) -> str:
    """Return XML text in which every element starts on the line that it was read from.

    The line numbers in messages of other programs, such as MuJoCo, are then those of the user's text.
    """
    parts: list[str] = []
    line = 1

    def put(element: Element) -> None:
        nonlocal line
        # An element that was read from a line that has passed stays on the present one.
        parts.append("\n" * max(element.line - line, 0))
        line = max(element.line, line)
        parts.append(f"<{element.tag}{_write_attributes(element)}>")
        for child in element.children:
            put(child)
        parts.append(f"</{element.tag}>")

    put(root)
    return "".join(parts)


def _write_attributes(element: Element) -> str:
    # Imported here, because it loads the network modules of the standard library and most callers only read.
    from xml.sax.saxutils import quoteattr

    for value in element.attributes.values():
        if NOT_XML.search(value):
            raise DynidentError(
                f"XML cannot contain {value!r}, because it has control characters. Rename the joint, link or robot.",
                title="Unusable name",
            )
    return "".join(f" {name}={quoteattr(value)}" for name, value in element.attributes.items())


def parse_attribute(
    element: Element, attribute: str, owner: str, fail: Callable[[str, int], DynidentError], count: int = 3
) -> tuple[float, ...]:
    """Return the numbers of an attribute; `fail` makes the error from a sentence, which names the owner, and a line."""
    written = element.attributes.get(attribute)
    expected = "a number" if count == 1 else f"{count} numbers"
    if written is None:
        raise fail(f"The <{element.tag}> of {owner} has no {attribute}; expected {expected}.", element.line)
    try:
        values = tuple(float(word) for word in written.split())
    except ValueError:
        values = ()
    # Infinite numbers are allowed in limits alone: some files write them where nothing is limited.
    if len(values) != count or not (all(map(math.isfinite, values)) or element.tag == "limit"):
        raise fail(f'{attribute}="{written}" in the <{element.tag}> of {owner}; expected {expected}.', element.line)
    if any(map(math.isnan, values)):
        raise fail(f'{attribute}="{written}" in the <{element.tag}> of {owner} is not a number.', element.line)
    return values
