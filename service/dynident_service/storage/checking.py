"""Check of rows that come from another service: each must be one that a service could have written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import JSON, BigInteger, Boolean, Column, Float, Integer, Table
from sqlalchemy.types import TypeEngine

from dynident_service.storage.tables import Text, UtcDateTime

LARGEST, LARGEST_BIG = 2**31 - 1, 2**63 - 1
"""Largest values of PostgreSQL's integer columns; SQLite would take larger ones."""


def check_rows(table: Table, rows: Sequence[Mapping[str, object]]) -> None:
    """Check that rows have all columns, with values that every supported database accepts.

    Raises
    ------
    ValueError
        For the first row that does not.
    """
    named = set(rows[0]) if rows else set()
    lacking = [column.name for column in table.columns if column.name not in named and not _is_optional_column(column)]
    if rows and lacking:
        raise ValueError(f"{table.name} has no {lacking[0]}")
    for number, row in enumerate(rows, 1):
        if set(row) != named:
            raise ValueError(f"row {number} of {table.name} has other columns than the first one")
        for column in table.columns:
            value = row.get(column.name)
            if value is None:
                if column.name in row and not column.nullable:
                    raise ValueError(f"row {number} of {table.name} has no {column.name}")
            elif not _fits_column(column.type, value):
                raise ValueError(f"row {number} of {table.name} has {str(value)[:40]!r} as its {column.name}")


def _is_optional_column(column: Column[Any]) -> bool:
    """Return whether a row may lack the column: older versions did not have every one."""
    return column.nullable or column.default is not None or column.server_default is not None


def _fits_column(kind: TypeEngine[Any], value: Any) -> bool:
    if isinstance(kind, Text):
        longest = getattr(kind.impl, "length", None) or math.inf
        return isinstance(value, str) and len(value) <= longest and _is_text(value)
    if isinstance(kind, UtcDateTime):
        return isinstance(value, datetime)
    if isinstance(kind, Boolean):
        return isinstance(value, bool)
    if isinstance(kind, Integer):
        most = LARGEST_BIG if isinstance(kind, BigInteger) else LARGEST
        # In Python True is an int; in PostgreSQL a boolean is none.
        return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most
    if isinstance(kind, Float):
        return isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(kind, JSON):
        return isinstance(value, dict | list) and _is_json_value(value)
    return False


def _is_text(value: str) -> bool:
    """Return whether every database can hold a text: it has no U+0000 and no lone surrogate."""
    return "\0" not in value and not any("\ud800" <= character <= "\udfff" for character in value)


def _is_json_value(value: Any) -> bool:
    """Return whether a value survives a round trip through JSON."""
    # A list instead of recursion: a hostile file may nest deeper than Python's stack.
    pending = [value]
    while pending:
        part = pending.pop()
        if isinstance(part, dict):
            pending += [*part.keys(), *part.values()]
        elif isinstance(part, list):
            pending += part
        elif isinstance(part, str):
            if not _is_text(part):
                return False
        elif isinstance(part, float) and not math.isfinite(part):
            return False
    return True
