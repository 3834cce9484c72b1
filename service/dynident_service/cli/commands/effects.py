"""`dynident effects`: the catalogue."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident_service.cli.shared_options import Json

if TYPE_CHECKING:
    from pydantic import BaseModel


def effects(as_json: Json = False) -> None:
    """List the effects that a model can contain."""
    from dynident.effects import CATALOGUE
    from dynident_service.cli import command_output, terminal

    rows = [
        [
            effect.id,
            effect.title,
            ", ".join(
                f"{parameter.name} ({parameter.unit})" if parameter.unit != "-" else parameter.name
                for parameter in effect.parameters
            ),
            effect.signature,
        ]
        for effect in CATALOGUE.values()
    ]
    columns = ("effect", "what it is", "parameters", "what it leaves in the residual")
    table = terminal.build_table("", columns, rows, right_from=len(columns))

    def describe_catalogue() -> BaseModel:
        from dynident_service.adapters.field_by_field import show_catalogue

        return show_catalogue()

    command_output.print_result(as_json, describe_catalogue, lambda console: console.print(table))
