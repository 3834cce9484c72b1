"""`dynident extend`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dynident_service.cli.files import TO_READ
from dynident_service.cli.options import Effects, Measurements, ModelArgument, Reading, Result, Validation


def extend(
    model: ModelArgument,
    measurements: Measurements,
    validation: Validation,
    reading: Reading,
    effects: Effects,
    result: Result,
    diagnosis: Annotated[
        Path | None,
        typer.Option(
            "--diagnosis", metavar="FILE", help="Add what a diagnosis recommends (`dynident diagnose --out`)."
        ),
        TO_READ,
    ] = None,
) -> None:
    """Add effects to a model.

    Give the measurements that it was identified from.
    """
    from dynident.errors import DynidentError
    from dynident.identification import extend as extend_model
    from dynident.progress import part
    from dynident_service.cli import inputs, telling, terminal

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
    telling.tell_rung(result, found, model.stem, identification)
