"""`dynident ladder`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident_service.cli.files import READABLE_FILE
from dynident_service.cli.options import Json, ModelArgument

if TYPE_CHECKING:
    from rich.console import Console


def ladder(
    model: ModelArgument,
    against: Annotated[
        Path | None,
        typer.Option("--against", metavar="MODEL", help="Another model, whose ladder is set beside it."),
        READABLE_FILE,
    ] = None,
    as_json: Json = False,
) -> None:
    """Show the models that led to one, and their errors; which predicts held-out data best, and where that rises."""
    from dynident.errors import DynidentError
    from dynident_service.adapters.ladders import build_steps, compare_ladders
    from dynident_service.cli import inputs, output, result_tables
    from dynident_service.models.identifications import Lineage

    identification = inputs.load_model(model)
    other = None if against is None else inputs.load_model(against)
    if other is not None and other.model.robot.joint_names != identification.model.robot.joint_names:
        raise DynidentError(f"{against} is a model of another robot", pointer="--against", title="Another robot")

    def describe_ladder() -> Lineage:
        own = build_steps(identification, model.stem)
        if other is None or against is None:
            return Lineage(items=own)
        data_sets = (step.data for top in (identification, other) for step in top.ladder())
        data = {(data_set.measurement_names, data_set.validation_names) for data_set in data_sets}
        return compare_ladders(own, build_steps(other, against.stem, (identification, model.stem)), len(data) == 1)

    def print_ladder(console: Console) -> None:
        if other is None or against is None:
            result_tables.show_ladder(console, identification)
        else:
            result_tables.show_ladders(console, (model.stem, identification), (against.stem, other))

    output.print_result(as_json, describe_ladder, print_ladder)
