"""Tables as plain text, for the representation of results in consoles."""

from __future__ import annotations

from collections.abc import Sequence


def format_text_table(
    title: str, columns: Sequence[str], rows: Sequence[Sequence[str]], count: int, *, right_from: int = 1
) -> str:
    """Return a title and a table as plain text.

    Parameters
    ----------
    title : str
    columns : sequence of str
        The heads.
    rows : sequence of sequences of str
        Each as long as `columns`.
    count : int
        Number of rows in all, where not all are given.
    right_from : int
        Columns from this index on are aligned to the right.

    Returns
    -------
    str
    """
    all_rows = [columns, *rows]
    widths = [max(len(row[k]) for row in all_rows) for k in range(len(columns))]
    lines = [
        "  "
        + "  ".join(_pad(text, width, k >= right_from) for k, (text, width) in enumerate(zip(row, widths, strict=True)))
        for row in all_rows
    ]
    rest = [f"  … and {count - len(rows)} more"] if count > len(rows) else []
    return "\n".join([title, *(line.rstrip() for line in lines), *rest])


def _pad(text: str, width: int, right: bool) -> str:
    return text.rjust(width) if right else text.ljust(width)
