"""Tables in words between the science and the contract."""

from __future__ import annotations

from collections.abc import Iterable

from dynident.reports.tables import ReportedTable
from dynident_service.adapters.answers import shown
from dynident_service.models.tables import Table, TableColumn


def show_tables(found: Iterable[ReportedTable]) -> list[Table]:
    """Show tables."""
    return [shown(Table, one, columns=_columns(one)) for one in found]


def _columns(found: ReportedTable) -> list[TableColumn]:
    return [TableColumn(word=word, figures=found.is_figures(k)) for k, word in enumerate(found.columns)]
