"""Conversion of the elements of a report's page to Typst code.

Every text becomes a Typst string, in which no character is markup.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable

from dynident.reports.printing.elements import Element

_MARKS = ("ok", "warning", "error", "plain")
_ROWS = ("pick", "poor", "total", "group")
_SHORT = 22
"""Characters that are never broken into lines."""
_LEFT_OUT = frozenset({"head", "nav", "style", "script"})


def typeset(page: Element) -> str:
    """Return the Typst markup of a whole page.

    Parameters
    ----------
    page : Element
        The root of the page's tree.

    Returns
    -------
    str
    """
    body, title = page.first("body") or page, page.first("title")
    title_text = "none" if title is None else _text(_words(title))
    return f"#set document(title: {title_text}, date: none)\n#{_blocks(body.children)}"


def _text(text: str) -> str:
    """Return a text as a Typst string; runs of white space become one space, as in HTML."""
    # Backslashes first: the escapes of quotes bring new ones.
    plain = re.sub(r"\s+", " ", text).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{plain}"'


def _joined(parts: Iterable[str]) -> str:
    return "{" + "; ".join(part for part in parts if part) + "}"


def _blocks(children: Iterable[Element | str]) -> str:
    """Return elements that stand one below the other; white space between them is dropped."""
    return _joined(_one(child) for child in children if isinstance(child, Element) or child.strip())


def _line(children: Iterable[Element | str]) -> str:
    """Return elements that follow each other within lines."""
    return _joined(_one(child) for child in children)


def _one(item: Element | str) -> str:
    if isinstance(item, str):
        return _text(item)
    if item.name in _LEFT_OUT:
        return ""
    write = _WRITTEN.get(item.name)
    return write(item) if write is not None else _line(item.children)


def _call(name: str) -> Callable[[Element], str]:
    return lambda element: f"{name}({_line(element.children)})"


def _container(element: Element) -> str:
    if "box" in element.classes:
        return f"report-box({_flag('warning' in element.classes)}, {_blocks(element.children)})"
    return _blocks(element.children)


def _paragraph(element: Element) -> str:
    return f"{'report-note' if 'note' in element.classes else 'par'}({_line(element.children)})"


def _list(name: str) -> Callable[[Element], str]:
    def write_list(element: Element) -> str:
        items = ", ".join(_line(item.children) for item in element.all("li"))
        small = f"report-note({name}({items}))"
        return small if "note" in element.classes else f"{name}({items})"

    return write_list


def _span(element: Element) -> str:
    content = _line(element.children)
    marks = [mark for mark in _MARKS if mark in element.classes] if "mark" in element.classes else []
    if marks:
        return f'report-mark("{marks[0]}", {content})'
    return f"report-small({content})" if "note" in element.classes else content


def _code(element: Element) -> str:
    return f"raw({_text(_words(element))})"


def _link(element: Element) -> str:
    """Return a link to another place; links within the page become plain text, since paper has no anchors."""
    target, text = element.attributes.get("href", ""), _line(element.children)
    return f"link({_text(target)}, {text})" if target.startswith("http") else text


def _words(element: Element) -> str:
    return "".join(child if isinstance(child, str) else _words(child) for child in element.children)


def _definitions(element: Element) -> str:
    """Return terms beside their definitions; the figures of the summary become cards."""
    if "figures" in element.classes:
        cards = [
            f"({', '.join(_line(part.children) for part in card.all('dt', 'dd'))},)" for card in element.all("div")
        ]
        return f"report-cards({', '.join(cards)})"
    facts = ", ".join(_line(part.children) for part in element.all("dt", "dd"))
    return f"report-facts({facts})"


def _drawing(element: Element) -> str:
    source = element.source.replace("\\", "\\\\").replace('"', '\\"')
    if "formula" not in element.classes:
        return f'image(bytes("{source}"), format: "svg", width: 100%)'
    size = re.search(r'style="width:([\d.]+)pt;height:([\d.]+)pt"', element.source)
    width, height = (size[1], size[2]) if size else ("60", "14")
    # Formulas are drawn for a font of 11 points; the template scales them to its own.
    return f'report-formula(bytes("{source}"), {width}pt, {height}pt)'


def _figure(element: Element) -> str:
    caption = element.first("figcaption")
    drawn = [child for child in element.children if child is not caption]
    below = _line(caption.children) if caption is not None else "none"
    return f"report-figure({_blocks(drawn)}, {below})"


def _folded(element: Element) -> str:
    """Return the title of a part that is folded on the page; its content is left out on paper."""
    line = element.first("summary")
    return f"report-folded({_line(line.children) if line is not None else 'none'})"


def _table(element: Element) -> str:
    caption, head = element.first("caption"), element.first("thead")
    heads = list(head.all("tr")) if head is not None else []
    # `thead` counts as one element of the search below, so that its rows are not found twice.
    within = {id(row) for row in heads}
    rows = [row for row in element.all("tr", "thead") if row.name == "tr" and id(row) not in within]
    columns = max((sum(_span_of(cell) for cell in row.all("th", "td")) for row in [*heads, *rows]), default=1)
    top = ", ".join(_cell(cell, "", is_head=True) for row in heads for cell in row.all("th", "td"))
    header = f"table.header({top}), " if top else ""
    body = ", ".join(_row(row, columns) for row in rows)
    widths = ", ".join(_widths(rows, columns))
    above = _line(caption.children) if caption is not None else "none"
    return f"report-table({above}, ({widths},), {header}{body})"


def _widths(rows: list[Element], columns: int) -> list[str]:
    """Return the widths of columns: short ones take what they need, long ones share the rest by their lengths."""
    longest = [0.0] * columns
    for row in rows:
        cells = list(row.all("th", "td"))
        if all(_span_of(cell) == 1 for cell in cells):
            for number, cell in enumerate(cells):
                longest[number] = max(longest[number], _length(cell))
    # The exponent below one keeps a single long text from taking nearly all of the width.
    return ["auto" if length <= _SHORT else f"{length**0.7:.1f}fr" for length in longest]


def _length(element: Element) -> float:
    """Return the number of characters in an element."""
    if element.name == "svg":
        # A drawing cannot be broken into lines, so its column counts as short and is never squeezed.
        return 0.0
    return sum(len(" ".join(child.split())) if isinstance(child, str) else _length(child) for child in element.children)


def _row(row: Element, columns: int) -> str:
    kind = next((row_kind for row_kind in _ROWS if row_kind in row.classes), "")
    cells = list(row.all("th", "td"))
    missing = columns - sum(map(_span_of, cells))
    return ", ".join([*(_cell(cell, kind, is_head=False) for cell in cells), *(["[]"] * missing)])


def _cell(cell: Element, row: str, *, is_head: bool) -> str:
    options = [f"colspan: {_span_of(cell)}"] if _span_of(cell) > 1 else []
    if "n" in cell.classes:
        options.append("align: right")
    if row:
        options.append(f'fill: report-row("{row}")')
    content = _span(cell)
    if is_head or row in ("total", "group"):
        content = f"strong({content})"
    # A box keeps a number and its unit in one line.
    if not is_head and {"n", "unit"} & cell.classes and _length(cell) <= _SHORT:
        content = f"box({content})"
    return f"table.cell({''.join(option + ', ' for option in options)}{content})"


def _span_of(cell: Element) -> int:
    return int(cell.attributes.get("colspan", "1"))


def _flag(value: bool) -> str:
    return "true" if value else "false"


_WRITTEN: dict[str, Callable[[Element], str]] = {
    "h1": _call("report-title"),
    "h2": _call("heading.with(level: 1)"),
    "h3": _call("heading.with(level: 2)"),
    "header": _container,
    "main": _container,
    "section": _container,
    "div": _container,
    "p": _paragraph,
    "ul": _list("list"),
    "ol": _list("enum"),
    "strong": _call("strong"),
    "em": _call("emph"),
    "sub": _call("sub"),
    "sup": _call("super"),
    "span": _span,
    "code": _code,
    "a": _link,
    "br": lambda _: "linebreak()",
    "dl": _definitions,
    "svg": _drawing,
    "figure": _figure,
    "details": _folded,
    "table": _table,
}
