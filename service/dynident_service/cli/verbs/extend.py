"""`dynident extend`."""

from __future__ import annotations

from typing import Annotated

import typer

from dynident_service.cli.options import (
    Effects,
    Measurements,
    ModelArgument,
    Reading,
    Result,
    SomeFile,
    Validation,
    of_file,
)


def extend(
    model: ModelArgument,
    measurements: Measurements,
    validation: Validation,
    reading: Reading,
    effects: Effects,
    result: Result,
    diagnosis: Annotated[
        SomeFile, of_file("--diagnosis", help="Add what a diagnosis recommends (`dynident diagnose --out`).")
    ] = None,
) -> None:
    """Add effects to a model.

    Give the measurements that it was identified from. Ends with the verdict on the model, as `identify` does.
    """
    from dynident.errors import DynidentError
    from dynident.identification import extend as extend_model
    from dynident.verdict import verdict
    from dynident_service.cli import inputs, shown, telling

    identification = inputs.model_of(model)
    robot = identification.model.robot
    added = inputs.effects_of(effects, robot)
    if diagnosis is not None:
        stored = inputs.stored_diagnosis(diagnosis)
        added += stored.recommended
        if not added:
            why = f"Nothing is added: the diagnosis recommends nothing. {stored.summary}"
            telling.tell_unchanged(result, identification, why)
            return
    if not added:
        raise DynidentError("say what to add: --effects, or --diagnosis with a file", pointer="--effects")
    with inputs.read("extend", measurements, robot, reading, validation) as read:
        found = extend_model(identification, added, read.recordings, read.other_recordings, read.progress)
        checks = {item.recording.name: item.checks for item in (*read.given, *read.others)}
        judged = verdict(found, read.recordings, read.other_recordings, checks)
    telling.tell_rung(result, found, model.stem, identification, judged)
    if judged.stop is not None:
        raise typer.Exit(shown.STOPPED)
