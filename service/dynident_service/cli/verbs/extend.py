"""`dynident extend`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import Effects, Json, Measurements, ModelArgument, Out, Reading, Validation


def extend(
    model: ModelArgument,
    measurements: Measurements,
    validation: Validation,
    reading: Reading,
    effects: Effects,
    diagnosis: Annotated[
        Path | None,
        typer.Option(
            "--diagnosis", metavar="FILE", help="Add what a diagnosis recommends (`dynident diagnose --out`)."
        ),
        TO_READ,
    ] = None,
    out: Out = None,
    as_json: Json = False,
) -> None:
    """Add effects to a model.

    Give the measurements that it was identified from.
    """
    from dynident.errors import DynidentError
    from dynident.identification import extend as extend_model
    from dynident.identification import to_bytes
    from dynident.progress import part
    from dynident_service.adapters.identifications import describe_identification
    from dynident_service.cli import inputs, shown, shown_ladders, terminal
    from dynident_service.models.common import plain

    identification = inputs.model_of(model)
    robot = identification.model.robot
    added = inputs.effects_of(effects, robot)
    if diagnosis is not None:
        added += inputs.stored_diagnosis(diagnosis).recommended
    if not added:
        raise DynidentError("say what to add: --effects, or --diagnosis with a file", pointer="--effects")
    with (
        terminal.progress_bar("extend") as progress,
        inputs.loaded(measurements, robot, reading, part(progress, 0.0, 0.5), validation) as (training, held_out),
    ):
        found = extend_model(
            identification,
            added,
            inputs.recordings_of(training),
            inputs.recordings_of(held_out),
            part(progress, 0.5, 1.0),
        )
    if out is not None:
        inputs.write_whole(out, to_bytes(found))
    if as_json:
        terminal.print_json(plain(describe_identification(found, model.stem, identification)))
        return
    console = terminal.out()
    shown_ladders.show_ladder(console, found)
    shown.show_identification(console, found, parameters=False)
    if out is not None:
        console.print(f"model written to {out}", markup=False)
