"""`dynident extend`."""

from __future__ import annotations

from typing import Annotated

import typer

from dynident_service.cli.options import (
    Effects,
    Measurements,
    ModelArgument,
    OutputOptions,
    Reading,
    SomeFile,
    Validation,
    file_option,
)


def extend(
    model: ModelArgument,
    measurements: Measurements,
    validation: Validation,
    reading: Reading,
    effects: Effects,
    result: OutputOptions,
    diagnosis: Annotated[
        SomeFile, file_option("--diagnosis", help="Add what a diagnosis recommends (`dynident diagnose --out`).")
    ] = None,
) -> None:
    """Add effects to a model.

    Give the measurements that it was identified from. Ends with the verdict on the model, as `identify` does.
    """
    from dynident.errors import DynidentError
    from dynident.identification import extend as extend_model
    from dynident.verdict import verdict
    from dynident_service.cli import inputs, output, result_tables

    identification = inputs.load_model(model)
    robot = identification.model.robot
    added = inputs.read_effects(effects, robot)
    if diagnosis is not None:
        stored_diagnosis = inputs.load_diagnosis(diagnosis)
        added += stored_diagnosis.recommended
        if not added:
            why = f"Nothing is added: the diagnosis recommends nothing. {stored_diagnosis.summary}"
            output.write_unchanged_model(result, identification, why)
            return
    if not added:
        raise DynidentError("say what to add: --effects, or --diagnosis with a file", pointer="--effects")
    with inputs.read_recordings("extend", measurements, robot, reading, validation) as data:
        extended = extend_model(identification, added, data.recordings, data.other_recordings, data.progress)
        checks = {item.recording.name: item.checks for item in (*data.loaded, *data.others)}
        model_verdict = verdict(extended, data.recordings, data.other_recordings, checks)
    output.write_extended_model(result, extended, model.stem, identification, model_verdict)
    if model_verdict.stop is not None:
        raise typer.Exit(result_tables.EXIT_STOPPED)
