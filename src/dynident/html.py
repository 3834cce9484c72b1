"""Small pieces of HTML, for what a notebook shows of a result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

_CELL = "padding:2px 10px 2px 0"


def table(columns: Sequence[str], rows: Iterable[Sequence[str]], *, right_from: int = 1) -> str:
    """A table of texts; columns from the number `right_from` on hold figures and stand to the right."""

    def cells(tag: str, texts: Sequence[str]) -> str:
        return "".join(
            f'<{tag} style="{_CELL};text-align:{"right" if k >= right_from else "left"}">{escape(text)}</{tag}>'
            for k, text in enumerate(texts)
        )

    head = f"<thead><tr>{cells('th', columns)}</tr></thead>"
    body = "".join(f"<tr>{cells('td', row)}</tr>" for row in rows)
    return f'<table style="border-collapse:collapse;font-size:90%">{head}<tbody>{body}</tbody></table>'


def paragraph(text: str, *, strong: bool = False) -> str:
    """A paragraph of plain text."""
    inner = f"<strong>{escape(text)}</strong>" if strong else escape(text)
    return f'<p style="margin:4px 0">{inner}</p>'


def listed(texts: Iterable[str]) -> str:
    """A list of plain texts; nothing where there are none."""
    items = "".join(f"<li>{escape(text)}</li>" for text in texts)
    return f'<ul style="margin:4px 0">{items}</ul>' if items else ""


def folded(title: str, content: str) -> str:
    """HTML that opens at a click on its title."""
    return f"<details><summary>{escape(title)}</summary>{content}</details>"


def block(*parts: str) -> str:
    """HTML under one roof."""
    return f"<div>{''.join(parts)}</div>"
