"""Validations printed as tables."""

from __future__ import annotations

from rich.console import Console

from dynident.reports.report_tables import ReportedTable
from dynident.robot import Robot
from dynident_service.adapters.validation_tables import build_validation_tables
from dynident_service.cli.terminal import build_table
from dynident_service.models.validations import ValidationResult

_MARKS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_STYLES = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold"}


def show_validation(console: Console, result: ValidationResult, robot: Robot) -> None:
    """Print the tables of a validation, its verdict, and the reason."""
    names = robot.joint_names
    by_number = {name: str(number) for number, name in enumerate(names, start=1)}
    for reported_table in build_validation_tables(result, names):
        # Where the terminal is too narrow for the joints' names as columns, their numbers stand there.
        short = by_number if _table_width(reported_table) > console.width else {}
        # Only names of joints are shortened; other heads stay as they are.
        columns = [short.get(column, column) for column in reported_table.columns]
        console.print(
            build_table(reported_table.title, columns, reported_table.texts, right_from=reported_table.numbers_from)
        )
        if columns != list(reported_table.columns):
            console.print(f"  Joints: {', '.join(f'{by_number[name]} {name}' for name in names)}.")
    console.print(_MARKS[result.verdict], style=_STYLES[result.verdict])
    console.print(result.reason)


def _table_width(reported_table: ReportedTable) -> int:
    """Return the width of a table in characters, with nothing wrapped."""
    lines = [reported_table.columns, *reported_table.texts]
    return sum(max(len(line[k]) for line in lines) + 2 for k in range(len(reported_table.columns)))
