"""Validations as tables for people."""

from __future__ import annotations

from rich.console import Console

from dynident.robot import Robot
from dynident_service.adapters.validation_tables import tables_of
from dynident_service.cli.terminal import table
from dynident_service.models.validations import ValidationResult

_MARKS = {"pass": "✓ pass", "fail": "✕ fail", "not_evaluated": "– not evaluated"}
_STYLES = {"pass": "bold green", "fail": "bold red", "not_evaluated": "bold"}


def show_validation(console: Console, found: ValidationResult, robot: Robot) -> None:
    """The figures, the verdict, its reason."""
    for one in tables_of(found, robot.joint_names):
        console.print(table(one.title, one.columns, [list(row) for row in one.rows], right_from=one.numbers_from))
    console.print(_MARKS[found.verdict], style=_STYLES[found.verdict])
    console.print(found.reason, markup=False)
