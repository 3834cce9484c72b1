"""Results as plain-text tables for consoles and as HTML for notebooks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from itertools import zip_longest


def format_text_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], count: int, *, right_from: int = 1
) -> str:
    """Return a title and a table as plain text.

    Parameters
    ----------
    title : str
        The line above the table.
    columns : sequence of str
        The heads, with line breaks where they have several lines.
    rows : sequence of sequences of str
        Each as long as `columns`.
    count : int
        Number of rows in all, where not all are given.
    right_from : int
        Columns from this index on are aligned to the right.

    Returns
    -------
    str
        Lines without blanks at their ends.
    """
    # Heads may have several lines.
    heads = zip_longest(*(column.split("\n") for column in columns), fillvalue="")
    all_rows = [*heads, *rows]
    widths = [max(len(row[k]) for row in all_rows) for k in range(len(columns))]
    lines = [
        "  "
        + "  ".join(_pad(text, width, k >= right_from) for k, (text, width) in enumerate(zip(row, widths, strict=True)))
        for row in all_rows
    ]
    # A table of many rows shows the first ones only and says how many it leaves out.
    rest = [f"  … and {count - len(rows)} more"] if count > len(rows) else []
    return "\n".join([title, *(line.rstrip() for line in lines), *rest])


def _pad(text: str, width: int, right: bool) -> str:
    return text.rjust(width) if right else text.ljust(width)


# Styles stand in the elements themselves: notebooks drop style sheets from what they show.
_CELL = "padding:2px 10px 2px 0"


def render_table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, right_from: int = 1) -> str:
    """Return a table of texts.

    Parameters
    ----------
    columns : sequence of str
        The heads.
    rows : iterable of sequences of str
        Texts, which are escaped; each row as long as `columns`.
    right_from : int
        Columns from this index on hold numbers and are aligned to the right.

    Returns
    -------
    str
        An HTML table.
    """

    def cells(tag: str, texts: Sequence[str]) -> str:
        return "".join(
            f'<{tag} style="{_CELL};text-align:{"right" if k >= right_from else "left"}">{escape(text)}</{tag}>'
            for k, text in enumerate(texts)
        )

    head = f"<thead><tr>{cells('th', columns)}</tr></thead>"
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<table style="border-collapse:collapse;font-size:90%">{head}<tbody>{body}</tbody></table>'


def render_paragraph(text: str, *, strong: bool = False) -> str:
    """Return a paragraph of plain text.

    Parameters
    ----------
    text : str
        Plain text, which is escaped.
    strong : bool
        Whether it is bold.

    Returns
    -------
    str
        An HTML element.
    """
    inner = f"<strong>{escape(text)}</strong>" if strong else escape(text)
    return f'<p style="margin:4px 0">{inner}</p>'


def render_list(texts: Iterable[str]) -> str:
    """Return a bulleted list of plain texts, which are escaped; "" where there are none."""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f'<ul style="margin:4px 0">{items}</ul>' if items else ""


def render_details(title: str, content: str) -> str:
    """Return HTML that shows its title and opens at a click.

    Parameters
    ----------
    title : str
        Plain text, which is escaped.
    content : str
        HTML.

    Returns
    -------
    str
        An HTML element that needs no script.
    """
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def join_html(*parts: str) -> str:
    """Return pieces of HTML as one element."""
    return f"<div>{''.join(parts)}</div>"
