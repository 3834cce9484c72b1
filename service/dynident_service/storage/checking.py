"""Rows that come from elsewhere: each must be one that a service itself could have written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import JSON, BigInteger, Boolean, Column, Float, Integer, Table
from sqlalchemy.types import TypeEngine

from dynident_service.storage.tables import Text, UtcDateTime

LARGEST, LARGEST_BIG = 2**31 - 1, 2**63 - 1


def check_rows(table: Table, rows: Sequence[Mapping[str, object]]) -> None:
    """Raise ValueError for a row that lacks a column, or has what the column cannot hold on some database."""
    named = set(rows[0]) if rows else set()
    lacking = [one.name for one in table.columns if one.name not in named and not _may_be_left_out(one)]
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
            elif not _fits(column.type, value):
                raise ValueError(f"row {number} of {table.name} has {str(value)[:40]!r} as its {column.name}")


def _may_be_left_out(column: Column[Any]) -> bool:
    """Older versions did not have every column."""
    return column.nullable or column.default is not None or column.server_default is not None


def _fits(kind: TypeEngine[Any], value: Any) -> bool:
    if isinstance(kind, Text):
        longest = getattr(kind.impl, "length", None) or math.inf
        return isinstance(value, str) and len(value) <= longest and _is_text(value)
    if isinstance(kind, UtcDateTime):
        return isinstance(value, datetime)
    if isinstance(kind, Boolean):
        return isinstance(value, bool)
    if isinstance(kind, Integer):
        most = LARGEST_BIG if isinstance(kind, BigInteger) else LARGEST
        return isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= most
    if isinstance(kind, Float):
        return isinstance(value, int | float) and not isinstance(value, bool)
    if isinstance(kind, JSON):
        return isinstance(value, dict | list) and _is_plain(value)
    return False


def _is_text(value: str) -> bool:
    """Whether every database holds it: no U+0000, no half of a pair of surrogates."""
    return "\0" not in value and not any("\ud800" <= one <= "\udfff" for one in value)


def _is_plain(value: Any) -> bool:
    """Whether JSON has it, and has it back; one level after the other, as there may be many."""
    left = [value]
    while left:
        one = left.pop()
        if isinstance(one, dict):
            left += [*one.keys(), *one.values()]
        elif isinstance(one, list):
            left += one
        elif isinstance(one, str):
            if not _is_text(one):
                return False
        elif isinstance(one, float) and not math.isfinite(one):
            return False
    return True
