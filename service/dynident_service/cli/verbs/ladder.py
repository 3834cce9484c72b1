"""`dynident ladder`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import Json, ModelArgument

if TYPE_CHECKING:
    from rich.console import Console


def ladder(
    model: ModelArgument,
    against: Annotated[
        Path | None,
        typer.Option("--against", metavar="MODEL", help="Another model, whose ladder is set beside it."),
        TO_READ,
    ] = None,
    as_json: Json = False,
) -> None:
    """Show the models that led to one, and their errors; which predicts held-out data best, and where that rises."""
    from dynident.errors import DynidentError
    from dynident_service.adapters.lineages import beside, rungs_of
    from dynident_service.cli import inputs, shown, telling
    from dynident_service.models.identifications import Lineage

    found = inputs.model_of(model)
    other = None if against is None else inputs.model_of(against)
    if other is not None and other.model.robot.joint_names != found.model.robot.joint_names:
        raise DynidentError(f"{against} is a model of another robot", pointer="--against", title="Another robot")

    def described() -> Lineage:
        own = rungs_of(found, model.stem)
        if other is None or against is None:
            return Lineage(items=own)
        known = (one.data for top in (found, other) for one in top.ladder())
        data = {(one.measurement_names, one.validation_names) for one in known}
        return beside(own, rungs_of(other, against.stem, (found, model.stem)), len(data) == 1)

    def show(console: Console) -> None:
        if other is None or against is None:
            shown.show_ladder(console, found)
        else:
            shown.show_ladders(console, (model.stem, found), (against.stem, other))

    telling.say(as_json, described, show)
