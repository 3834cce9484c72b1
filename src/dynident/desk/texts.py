"""Tables of plain text, for what Python prints of a result."""

from __future__ import annotations

from collections.abc import Sequence


def text_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], count: int, *, right_from: int = 1
) -> str:
    """A title and rows under their heads; `count` is how many rows there are in all, where not all are given."""
    everything = [columns, *rows]
    widths = [max(len(row[k]) for row in everything) for k in range(len(columns))]
    lines = [
        "  "
        + "  ".join(
            _padded(text, width, k >= right_from) for k, (text, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in everything
    ]
    more = [f"  … and {count - len(rows)} more"] if count > len(rows) else []
    return "\n".join([title, *(line.rstrip() for line in lines), *more])


def _padded(text: str, width: int, right: bool) -> str:
    return text.rjust(width) if right else text.ljust(width)
