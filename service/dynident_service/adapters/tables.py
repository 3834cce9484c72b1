"""Tables in words between the science and the contract."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.reports.tables import ReportedTable
from dynident_service.adapters.answers import shown
from dynident_service.models.tables import Table, TableColumn


def show_tables(found: Iterable[ReportedTable]) -> list[Table]:
    """Show tables; a column holds figures where any of its cells is one."""
    return [shown(Table, one, columns=_columns(one)) for one in found]


def _columns(found: ReportedTable) -> list[TableColumn]:
    figures = (any(row[k].value is not None for row in found.rows) for k in range(len(found.columns)))
    return [TableColumn(word=word, figures=is_one) for word, is_one in zip(found.columns, figures, strict=True)]
