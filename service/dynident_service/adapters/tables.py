"""Tables of reports as views."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.reports.report_tables import ReportedTable
from dynident_service.adapters.serialise import to_view
from dynident_service.models.tables import Table, TableColumn


def show_tables(tables: Iterable[ReportedTable]) -> list[Table]:
    """Build the views of tables."""
    return [to_view(Table, table, columns=_show_columns(table)) for table in tables]


def _show_columns(table: ReportedTable) -> list[TableColumn]:
    return [TableColumn(word=word, figures=table.is_figures(k)) for k, word in enumerate(table.columns)]
