"""Validations as tables for people."""

from __future__ import annotations

from rich.console import Console

from dynident.reports.tables import ReportedTable
from dynident.robot import Robot
from dynident_service.adapters.validation_tables import tables_of
from dynident_service.cli.terminal import table
from dynident_service.models.validations import ValidationResult

_MARKS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_STYLES = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold"}


def show_validation(console: Console, found: ValidationResult, robot: Robot) -> None:
    """The figures, the verdict, its reason."""
    names = robot.joint_names
    by_number = {name: str(number) for number, name in enumerate(names, start=1)}
    for one in tables_of(found, names):
        # Joints across the page take their numbers where the page is too narrow for their names.
        short = by_number if _width(one) > console.width else {}
        columns = [short.get(column, column) for column in one.columns]
        console.print(table(one.title, columns, one.texts, right_from=one.numbers_from))
        if columns != list(one.columns):
            console.print(f"  Joints: {', '.join(f'{by_number[name]} {name}' for name in names)}.")
    console.print(_MARKS[found.verdict], style=_STYLES[found.verdict])
    console.print(found.reason)


def _width(shown: ReportedTable) -> int:
    """Characters that a table takes with nothing wrapped."""
    lines = [shown.columns, *shown.texts]
    return sum(max(len(line[k]) for line in lines) + 2 for k in range(len(shown.columns)))
