"""The PDF of a report: its HTML is converted to Typst and typeset.

The HTML page is parsed to a tree of elements, which is converted to Typst code. Every text becomes a Typst string, in
which no character is markup.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from typing import Literal

import matplotlib
import typst

from dynident.text_encoding import encode_text

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
        Its attributes by name.
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
        """Return the first of the elements that `find_all` yields; None where there is none."""
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
            # Only the class is read of a drawing: Typst gets its source as it is.
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


_MARKS = ("ok", "warning", "error", "plain")
_ROWS = ("pick", "poor", "total", "group")
_UNBROKEN_LENGTH = 22
"""Characters that are never broken into lines."""
_OMITTED_ELEMENTS = frozenset({"head", "nav", "style", "script"})


def typeset_page(page: Element) -> str:
    """Return the Typst markup of a whole page.

    Parameters
    ----------
    page : Element
        The root of the page's tree.

    Returns
    -------
    str
        The page as Typst code.
    """
    body, title = page.find_first("body") or page, page.find_first("title")
    title_text = "none" if title is None else _quote_text(_collect_text(title))
    return f"#set document(title: {title_text}, date: none)\n#{_typeset_blocks(body.children)}"


def _quote_text(text: str) -> str:
    """Return a text as a Typst string; runs of white space become one space, as in HTML."""
    # Backslashes first: the escapes of quotes bring new ones.
    plain = re.sub(r"\s+", " ", text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{plain}"'


def _join_parts(parts: Iterable[str]) -> str:
    return "{" + "; ".join(part for part in parts if part) + "}"


def _typeset_blocks(children: Iterable[Element | str]) -> str:
    """Return elements that stand one below the other; white space between them is dropped."""
    return _join_parts(_typeset_item(child) for child in children if isinstance(child, Element) or child.strip())


def _typeset_inline(children: Iterable[Element | str]) -> str:
    """Return elements that follow each other within lines."""
    return _join_parts(_typeset_item(child) for child in children)


def _typeset_item(item: Element | str) -> str:
    if isinstance(item, str):
        return _quote_text(item)
    if item.name in _OMITTED_ELEMENTS:
        return ""
    write = _TYPESETTERS.get(item.name)
    return write(item) if write is not None else _typeset_inline(item.children)


def _make_call(name: str) -> Callable[[Element], str]:
    return lambda element: f"{name}({_typeset_inline(element.children)})"


def _typeset_container(element: Element) -> str:
    if "box" in element.classes:
        return f"report-box({_format_flag('warning' in element.classes)}, {_typeset_blocks(element.children)})"
    return _typeset_blocks(element.children)


def _typeset_paragraph(element: Element) -> str:
    return f"{'report-note' if 'note' in element.classes else 'par'}({_typeset_inline(element.children)})"


def _make_list_writer(name: str) -> Callable[[Element], str]:
    def write_list(element: Element) -> str:
        items = ", ".join(_typeset_inline(item.children) for item in element.find_all("li"))
        small = f"report-note({name}({items}))"
        return small if "note" in element.classes else f"{name}({items})"

    return write_list


def _typeset_span(element: Element) -> str:
    content = _typeset_inline(element.children)
    marks = [mark for mark in _MARKS if mark in element.classes] if "mark" in element.classes else []
    if marks:
        return f'report-mark("{marks[0]}", {content})'
    return f"report-small({content})" if "note" in element.classes else content


def _typeset_code(element: Element) -> str:
    return f"raw({_quote_text(_collect_text(element))})"


def _typeset_link(element: Element) -> str:
    """Return a link to another place; links within the page become plain text, since paper has no anchors."""
    target, text = element.attributes.get("href", ""), _typeset_inline(element.children)
    return f"link({_quote_text(target)}, {text})" if target.startswith("http") else text


def _collect_text(element: Element) -> str:
    return "".join(child if isinstance(child, str) else _collect_text(child) for child in element.children)


def _typeset_definitions(element: Element) -> str:
    """Return terms beside their definitions; the figures of the summary become cards."""
    if "figures" in element.classes:
        cards = [
            f"({', '.join(_typeset_inline(part.children) for part in card.find_all('dt', 'dd'))},)"
            for card in element.find_all("div")
        ]
        return f"report-cards({', '.join(cards)})"
    facts = ", ".join(_typeset_inline(part.children) for part in element.find_all("dt", "dd"))
    return f"report-facts({facts})"


def _typeset_drawing(element: Element) -> str:
    source = element.source.replace("\\", "\\\\").replace('"', '\\"')
    if "formula" not in element.classes:
        return f'image(bytes("{source}"), format: "svg", width: 100%)'
    # `draw_formula` states the size of a formula in points, by which it fits into a line of text.
    size = re.search(r'style="width:([\d.]+)pt;height:([\d.]+)pt"', element.source)
    width, height = (size[1], size[2]) if size else ("60", "14")
    # Formulas are drawn for a font of 11 points; the template scales them to its own.
    return f'report-formula(bytes("{source}"), {width}pt, {height}pt)'


def _typeset_figure(element: Element) -> str:
    caption = element.find_first("figcaption")
    drawn = [child for child in element.children if child is not caption]
    below = _typeset_inline(caption.children) if caption is not None else "none"
    return f"report-figure({_typeset_blocks(drawn)}, {below})"


def _typeset_details(element: Element) -> str:
    """Return the title of a part that is folded on the page; its content is left out on paper."""
    line = element.find_first("summary")
    return f"report-folded({_typeset_inline(line.children) if line is not None else 'none'})"


def _typeset_table(element: Element) -> str:
    caption, head = element.find_first("caption"), element.find_first("thead")
    heads = list(head.find_all("tr")) if head is not None else []
    # `thead` counts as one element of the search below, so that its rows are not found twice.
    within = {id(row) for row in heads}
    rows = [row for row in element.find_all("tr", "thead") if row.name == "tr" and id(row) not in within]
    columns = max(
        (sum(_get_column_span(cell) for cell in row.find_all("th", "td")) for row in [*heads, *rows]), default=1
    )
    top = ", ".join(_typeset_cell(cell, "", is_head=True) for row in heads for cell in row.find_all("th", "td"))
    header = f"table.header({top}), " if top else ""
    body = ", ".join(_typeset_row(row, columns) for row in rows)
    widths = ", ".join(_compute_widths(rows, columns))
    above = _typeset_inline(caption.children) if caption is not None else "none"
    return f"report-table({above}, ({widths},), {header}{body})"


def _compute_widths(rows: list[Element], columns: int) -> list[str]:
    """Return the widths of columns: short ones take what they need, long ones share the rest by their lengths."""
    longest = [0.0] * columns
    for row in rows:
        cells = list(row.find_all("th", "td"))
        if all(_get_column_span(cell) == 1 for cell in cells):
            for number, cell in enumerate(cells):
                longest[number] = max(longest[number], _count_characters(cell))
    # The exponent below one keeps a single long text from taking nearly all of the width.
    return ["auto" if length <= _UNBROKEN_LENGTH else f"{length**0.7:.1f}fr" for length in longest]


def _count_characters(element: Element) -> float:
    """Return the number of characters in an element."""
    if element.name == "svg":
        # A drawing cannot be broken into lines, so its column counts as short and is never squeezed.
        return 0.0
    return sum(
        len(" ".join(child.split())) if isinstance(child, str) else _count_characters(child)
        for child in element.children
    )


def _typeset_row(row: Element, columns: int) -> str:
    kind = next((row_kind for row_kind in _ROWS if row_kind in row.classes), "")
    cells = list(row.find_all("th", "td"))
    # Typst fills its grid cell by cell: a row that lacks some would take them from the next one.
    missing = columns - sum(map(_get_column_span, cells))
    return ", ".join([*(_typeset_cell(cell, kind, is_head=False) for cell in cells), *(["[]"] * missing)])


def _typeset_cell(cell: Element, row: str, *, is_head: bool) -> str:
    options = [f"colspan: {_get_column_span(cell)}"] if _get_column_span(cell) > 1 else []
    if "n" in cell.classes:
        options.append("align: right")
    if row:
        options.append(f'fill: report-row("{row}")')
    content = _typeset_span(cell)
    if is_head or row in ("total", "group"):
        content = f"strong({content})"
    # A box keeps a number and its unit in one line.
    if not is_head and {"n", "unit"} & cell.classes and _count_characters(cell) <= _UNBROKEN_LENGTH:
        content = f"box({content})"
    return f"table.cell({''.join(option + ', ' for option in options)}{content})"


def _get_column_span(cell: Element) -> int:
    return int(cell.attributes.get("colspan", "1"))


def _format_flag(value: bool) -> str:
    return "true" if value else "false"


_TYPESETTERS: dict[str, Callable[[Element], str]] = {
    "h1": _make_call("report-title"),
    "h2": _make_call("heading.with(level: 1)"),
    "h3": _make_call("heading.with(level: 2)"),
    "header": _typeset_container,
    "main": _typeset_container,
    "section": _typeset_container,
    "div": _typeset_container,
    "p": _typeset_paragraph,
    "ul": _make_list_writer("list"),
    "ol": _make_list_writer("enum"),
    "strong": _make_call("strong"),
    "em": _make_call("emph"),
    "sub": _make_call("sub"),
    "sup": _make_call("super"),
    "span": _typeset_span,
    "code": _typeset_code,
    "a": _typeset_link,
    "br": lambda _: "linebreak()",
    "dl": _typeset_definitions,
    "svg": _typeset_drawing,
    "figure": _typeset_figure,
    "details": _typeset_details,
    "table": _typeset_table,
}


def render_pdf(page: str) -> bytes:
    """Typeset a report that `html_report` wrote on numbered A4 pages, as PDF.

    Folded parts of the page are left out. The fonts are those that come with matplotlib, and the date stands in the
    page itself, so the same page gives the same file on every machine.

    Parameters
    ----------
    page : str
        The HTML.

    Returns
    -------
    bytes
        The file.
    """
    source = f"{_read_preamble()}\n{typeset_page(parse_page(page))}\n"
    return typst.compile(encode_text(source), font_paths=_load_fonts(), format="pdf")


def render_drawing(svg: str, image_format: Literal["png", "pdf"], dpi: float = 200.0) -> bytes:
    """Render an SVG drawing as a picture or a page of its own size, on white.

    Parameters
    ----------
    svg : str
        One <svg> element whose viewBox is in points.
    image_format : "png" or "pdf"
        What is returned.
    dpi : float
        Pixels per inch of a PNG.

    Returns
    -------
    bytes
        The file.
    """
    source = svg.replace("\\", "\\\\").replace('"', '\\"')
    page = f'#set page(width: auto, height: auto, margin: 4pt, fill: white)\n#image(bytes("{source}"), format: "svg")'
    return typst.compile(encode_text(page), font_paths=_load_fonts(), format=image_format, ppi=dpi)


@lru_cache(maxsize=1)
def _read_preamble() -> str:
    return files("dynident.reports").joinpath("templates", "report.typ").read_text(encoding="utf-8")


@lru_cache(maxsize=1)
def _load_fonts() -> typst.Fonts:
    return typst.Fonts(include_system_fonts=False, font_paths=[Path(matplotlib.get_data_path()) / "fonts" / "ttf"])
